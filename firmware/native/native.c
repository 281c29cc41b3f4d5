// The controller's core on a simulated board, in virtual time. Event-driven: time jumps from one thing that happens to
// the next, so an hour of scanning costs what its edges and bytes cost.
//
// Stands for the RP2040's PIO, DMA, UART and watchdog as board.h promises them, without input synchronisers: an output
// follows its edge by exactly the loaded delay.

#include "native.h"

#include <stdlib.h>
#include <string.h>

#include "../board.h"
#include "../core/controller.h"

#define NEVER UINT64_MAX
#define EDGES_KEPT 8U
#define INPUTS_MAX 65536U
#define LINE_IN_MAX 65536U
#define BUFFER_IN_MAX 256U
#define BUFFER_OUT_MAX 64U
#define LINE_OUT_MAX (1U << 17)
#define TRANSITIONS_MAX (1U << 17)
#define TRAIN_STEPS_MAX (PROTOCOL_CHIPS_MAX + 8U)
#define LAMP_WIDTH_MAX_TICKS (LIMIT_LAMP_WIDTH_MAX_US * 100U)
#define STARVED_TICKS (BOARD_STARVED_MS * 100000ULL)
#define WATCHDOG_TICKS (BOARD_WATCHDOG_MS * 100000ULL)

typedef struct {
    uint64_t tick;
    uint64_t order;  // of scheduling, breaks ties
    uint8_t pin;
    uint8_t level;
} input_t;

typedef struct {
    int64_t offset;  // from chip 0
    uint8_t pin;     // 0 = end of the burst
    uint8_t level;
} train_step_t;

// A serial line, both ways; the one that stands for USB can be unplugged.
typedef struct {
    struct {
        size_t first;  // on the line to the controller
        size_t count;
        uint64_t arrival;  // of the first of them
        uint8_t buffer[BUFFER_IN_MAX];
        size_t buffer_count;
    } in;
    struct {
        uint8_t buffer[BUFFER_OUT_MAX];  // ring, in the controller
        size_t buffer_first;
        size_t buffer_count;
        uint64_t departure;  // of the first of them has left the line
        size_t first;        // waiting for the host
        size_t count;
    } out;
} line_t;

static struct {
    uint64_t now;
    bool powered;
    uint64_t boot_tick;
    uint8_t boot;
    uint8_t cause;
    bool reset_wanted;
    bool in_bootloader;
    uint8_t levels[PIN_COUNT];
    native_lost_t lost;
    bool refuse_next;

    input_t inputs[INPUTS_MAX];  // binary heap
    size_t input_count;
    uint64_t input_order;

    native_transition_t transitions[TRANSITIONS_MAX];  // ring
    size_t transition_first;
    size_t transition_count;

    uint64_t next_round;  // main loop
    uint64_t stalled_until;
    uint64_t kicked;

    line_t lines[LINES];
    bool usb_connected;
    bool usb_held;

    struct {
        board_flash_t loaded;
        bool is_loaded;
        uint64_t refuse_until;
        uint32_t holdoff;
        uint32_t refused;
        board_edge_t edges[EDGES_KEPT];
        size_t edge_count;
        uint8_t pin;  // of the flash being timed, 0 = none
        uint64_t on;
        uint64_t off;
    } lamps;

    int32_t odometer;
    bool interlock_tripped;

    struct {
        bool enabled;
        bool starved;
        bool running;
        bool stopping;
        train_step_t steps[TRAIN_STEPS_MAX];
        size_t step_count;
        size_t step;
        uint64_t chip0;  // of the current burst
        uint32_t period;
        uint16_t repeat;
        uint16_t done;
    } train;

    struct {
        int32_t position;
        int32_t target;
        uint32_t period;
        bool hold;
        bool moving;
        uint64_t next;
    } motor;
} world;

// Apart from `world`, so that a fresh one costs no megabytes of zeroes.
static input_t inputs[INPUTS_MAX];                        // binary heap
static native_transition_t transitions[TRANSITIONS_MAX];  // ring
static uint8_t line_in[LINES][LINE_IN_MAX];               // rings
static uint8_t line_out[LINES][LINE_OUT_MAX];             // rings

static controller_t controller;

// ---- pins and inputs ----

static void drive(const uint8_t pin, const uint8_t level)
{
    if (world.levels[pin] == level) {
        return;
    }
    world.levels[pin] = level;
    if (world.transition_count == TRANSITIONS_MAX) {
        world.lost.transitions++;
        return;
    }
    const size_t at = (world.transition_first + world.transition_count++) % TRANSITIONS_MAX;
    transitions[at] = (native_transition_t){.tick = world.now, .pin = pin, .level = level};
}

static bool is_before(const input_t* const a, const input_t* const b)
{
    return (a->tick != b->tick) ? a->tick < b->tick : a->order < b->order;
}

static void swap_inputs(const size_t a, const size_t b)
{
    const input_t kept = inputs[a];
    inputs[a] = inputs[b];
    inputs[b] = kept;
}

static input_t pop_input(void)
{
    const input_t first = inputs[0];
    inputs[0] = inputs[--world.input_count];
    for (size_t at = 0;;) {
        size_t least = at;
        for (size_t child = 2U * at + 1U; child <= 2U * at + 2U; child++) {
            if ((child < world.input_count) && is_before(&inputs[child], &inputs[least])) {
                least = child;
            }
        }
        if (least == at) {
            return first;
        }
        swap_inputs(at, least);
        at = least;
    }
}

// The main loop sees what just happened a moment later.
static void wake_cpu(void)
{
    const uint64_t soon = world.now + NATIVE_LATENCY_TICKS;
    if (soon < world.next_round) {
        world.next_round = (soon > world.stalled_until) ? soon : world.stalled_until;
    }
}

static void take_edge(void)
{
    const bool is_full = world.lamps.edge_count == EDGES_KEPT;
    if ((world.now < world.lamps.refuse_until) || is_full) {
        world.lamps.refused++;
        return;
    }
    const board_flash_t* const flash = &world.lamps.loaded;
    board_edge_t* const edge = &world.lamps.edges[world.lamps.edge_count++];
    *edge = (board_edge_t){.tick = board_tick(), .tag = 0, .odometer = world.odometer};
    if (world.lamps.pin != 0U) {  // ends with this very tick; board_flash_load let no longer one through
        drive(world.lamps.pin, 0);
        world.lamps.pin = 0;
    }
    if (world.lamps.is_loaded) {
        world.lamps.is_loaded = false;
        edge->tag = flash->tag;
        world.lamps.holdoff = flash->holdoff_ticks;
        if ((flash->lamp != LAMP_DARK) && (flash->width_ticks > 0U)) {
            world.lamps.pin = (flash->lamp == LAMP_LED) ? PIN_LED : PIN_PROJECTOR;
            world.lamps.on = world.now + flash->delay_ticks;
            world.lamps.off = world.lamps.on + flash->width_ticks;
        }
    }
    world.lamps.refuse_until = world.now + world.lamps.holdoff;
}

// Steps of A, B as a Gray code: +1 when A leads. A jump of two says nothing and counts nothing.
static int32_t quadrature_step(const uint8_t before, const uint8_t after)
{
    static const int8_t steps[16] = {0, -1, 1, 0, 1, 0, 0, -1, -1, 0, 0, 1, 0, 1, -1, 0};
    return steps[before * 4U + after];
}

static uint8_t quadrature_state(void)
{
    return (uint8_t)(world.levels[PIN_ODOMETER_A] * 2U + world.levels[PIN_ODOMETER_B]);
}

static void end_train(void)
{
    world.train.running = false;
    drive(PIN_MICROWAVE, 0);
    drive(PIN_TRIGGER, 0);
    wake_cpu();
}

static void apply_input(const input_t* const input)
{
    const uint8_t before = quadrature_state();
    const bool changed = world.levels[input->pin] != input->level;
    world.levels[input->pin] = input->level;
    if (!world.powered || !changed) {
        return;
    }
    world.odometer += quadrature_step(before, quadrature_state());
    if ((input->pin == PIN_SYNC) && (input->level == 0U)) {
        take_edge();
        wake_cpu();
    }
    if ((input->pin == PIN_INTERLOCK) && (input->level == 1U)) {
        world.interlock_tripped = true;
        world.train.enabled = false;
        end_train();
    }
}

// ---- what happens when ----

static uint64_t lamp_time(void)
{
    if (world.lamps.pin == 0U) {
        return NEVER;
    }
    return (world.levels[world.lamps.pin] == 0U) ? world.lamps.on : world.lamps.off;
}

static void step_lamp(void)
{
    const uint8_t pin = world.lamps.pin;
    if (world.levels[pin] == 0U) {
        drive(pin, 1);
    } else {
        drive(pin, 0);
        world.lamps.pin = 0;
    }
}

static uint64_t train_time(void)
{
    return world.train.running ? world.train.chip0 + (uint64_t)world.train.steps[world.train.step].offset : NEVER;
}

static void step_train(void)
{
    const train_step_t* const step = &world.train.steps[world.train.step++];
    if (step->pin != 0U) {
        drive(step->pin, step->level);
        return;
    }
    world.train.done++;
    world.train.step = 0;
    world.train.chip0 += world.train.period;
    if (world.train.stopping || (world.train.done == world.train.repeat)) {
        end_train();
    }
}

// The main loop's credit for the microwave is used up.
static uint64_t starving_time(void)
{
    return world.train.enabled ? world.kicked + STARVED_TICKS : NEVER;
}

static void starve(void)
{
    world.train.enabled = false;
    world.train.starved = true;
    end_train();
}

static uint64_t motor_time(void)
{
    return world.motor.moving ? world.motor.next : NEVER;
}

static void step_motor(void)
{
    if (world.motor.position == world.motor.target) {
        world.motor.moving = false;
        drive(PIN_ENABLE, world.motor.hold ? 0 : 1);
        wake_cpu();
        return;
    }
    if (world.levels[PIN_STEP] == 0U) {
        drive(PIN_STEP, 1);
        world.motor.next += world.motor.period / 2U;
    } else {
        drive(PIN_STEP, 0);
        world.motor.position += (world.levels[PIN_DIRECTION] == 1U) ? 1 : -1;
        world.motor.next += world.motor.period - world.motor.period / 2U;
    }
}

static uint64_t arrival_time(const uint8_t line)
{
    return (world.lines[line].in.count > 0U) ? world.lines[line].in.arrival : NEVER;
}

static void step_arrival(const uint8_t line)
{
    line_t* const self = &world.lines[line];
    const uint8_t byte = line_in[line][self->in.first];
    self->in.first = (self->in.first + 1U) % LINE_IN_MAX;
    self->in.count--;
    self->in.arrival = world.now + NATIVE_BYTE_TICKS;
    if (!world.powered) {
        return;
    }
    if (self->in.buffer_count == BUFFER_IN_MAX) {
        world.lost.received++;
        return;
    }
    self->in.buffer[self->in.buffer_count++] = byte;
    wake_cpu();
}

static uint64_t departure_time(const uint8_t line)
{
    const bool waits = (line == LINE_USB) && world.usb_held;
    return ((world.lines[line].out.buffer_count > 0U) && !waits) ? world.lines[line].out.departure : NEVER;
}

static void step_departure(const uint8_t line)
{
    line_t* const self = &world.lines[line];
    const uint8_t byte = self->out.buffer[self->out.buffer_first];
    self->out.buffer_first = (self->out.buffer_first + 1U) % BUFFER_OUT_MAX;
    self->out.buffer_count--;
    self->out.departure = world.now + NATIVE_BYTE_TICKS;
    if (self->out.count == LINE_OUT_MAX) {
        world.lost.sent++;
    } else {
        line_out[line][(self->out.first + self->out.count++) % LINE_OUT_MAX] = byte;
    }
    if (self->out.buffer_count < BUFFER_OUT_MAX / 2U) {
        wake_cpu();
    }
}

static void round_of_cpu(void)
{
    world.next_round = world.now + NATIVE_ROUND_TICKS;
    controller_run(&controller);
    if (world.reset_wanted) {
        world.reset_wanted = false;
        native_power_on((uint8_t)(world.boot + 1U), BOOT_CAUSE_HOST_RESET);
    } else if ((world.lines[LINE_UART].in.buffer_count > 0U) || (world.lines[LINE_USB].in.buffer_count > 0U)) {
        wake_cpu();
    }
}

void native_run_until(const uint64_t tick)
{
    enum {
        INPUT,
        LAMP,
        TRAIN,
        MOTOR,
        ARRIVAL,
        USB_ARRIVAL,
        DEPARTURE,
        USB_DEPARTURE,
        STARVING,
        ROUND,
        WATCHDOG,
        SOURCES
    };
    for (;;) {
        const uint64_t times[SOURCES] = {
            [INPUT] = (world.input_count > 0U) ? inputs[0].tick : NEVER,
            [LAMP] = lamp_time(),
            [TRAIN] = train_time(),
            [MOTOR] = motor_time(),
            [ARRIVAL] = arrival_time(LINE_UART),
            [USB_ARRIVAL] = arrival_time(LINE_USB),
            [DEPARTURE] = departure_time(LINE_UART),
            [USB_DEPARTURE] = departure_time(LINE_USB),
            [STARVING] = starving_time(),
            [ROUND] = world.powered ? world.next_round : NEVER,
            [WATCHDOG] = world.powered ? world.kicked + WATCHDOG_TICKS : NEVER,
        };
        uint32_t first = INPUT;
        for (uint32_t source = LAMP; source < SOURCES; source++) {
            if (times[source] < times[first]) {  // at one tick: hardware before the main loop
                first = source;
            }
        }
        if (times[first] > tick) {
            break;
        }
        world.now = (times[first] > world.now) ? times[first] : world.now;
        switch (first) {
        case INPUT: {
            const input_t input = pop_input();
            apply_input(&input);
            break;
        }
        case LAMP:
            step_lamp();
            break;
        case TRAIN:
            step_train();
            break;
        case MOTOR:
            step_motor();
            break;
        case ARRIVAL:
        case USB_ARRIVAL:
            step_arrival((first == ARRIVAL) ? LINE_UART : LINE_USB);
            break;
        case DEPARTURE:
        case USB_DEPARTURE:
            step_departure((first == DEPARTURE) ? LINE_UART : LINE_USB);
            break;
        case STARVING:
            starve();
            break;
        case ROUND:
            round_of_cpu();
            break;
        default:
            native_power_on((uint8_t)(world.boot + 1U), BOOT_CAUSE_WATCHDOG);
            break;
        }
    }
    world.now = (tick > world.now) ? tick : world.now;
}

// ---- the host's side ----

void native_begin(void)
{
    memset(&world, 0, sizeof world);
    world.levels[PIN_SYNC] = 1;
    world.levels[PIN_INTERLOCK] = 1;
    world.levels[PIN_ENABLE] = 1;
}

static void outputs_at_rest(void)
{
    static const uint8_t low_at_reset[] = {PIN_PROJECTOR, PIN_LED,       PIN_MICROWAVE, PIN_TRIGGER,
                                           PIN_STEP,      PIN_DIRECTION, PIN_STATUS};
    for (size_t i = 0; i < sizeof low_at_reset; i++) {
        drive(low_at_reset[i], 0);
    }
    drive(PIN_ENABLE, 1);
    memset(&world.lamps, 0, sizeof world.lamps);
    memset(&world.train, 0, sizeof world.train);
    memset(&world.motor, 0, sizeof world.motor);
}

void native_power_on(const uint8_t boot, const uint8_t cause)
{
    outputs_at_rest();
    world.in_bootloader = false;
    for (size_t line = 0; line < LINES; line++) {
        world.lines[line].in.buffer_count = 0;
        world.lines[line].out.buffer_count = 0;
    }
    world.odometer = 0;
    world.interlock_tripped = false;
    world.refuse_next = false;
    world.stalled_until = 0;
    world.powered = true;
    world.boot_tick = world.now;
    world.boot = boot;
    world.cause = cause;
    world.kicked = world.now;
    world.next_round = world.now;
    controller_start(&controller);
}

bool native_input(const uint64_t tick, const uint8_t pin, const uint8_t level)
{
    const bool is_input =
        (pin == PIN_SYNC) || (pin == PIN_INTERLOCK) || (pin == PIN_ODOMETER_A) || (pin == PIN_ODOMETER_B);
    if (!is_input || (level > 1U) || (tick < world.now) || (world.input_count == INPUTS_MAX)) {
        world.lost.inputs++;
        return false;
    }
    size_t at = world.input_count++;
    inputs[at] = (input_t){.tick = tick, .order = world.input_order++, .pin = pin, .level = level};
    while ((at > 0U) && is_before(&inputs[at], &inputs[(at - 1U) / 2U])) {
        swap_inputs(at, (at - 1U) / 2U);
        at = (at - 1U) / 2U;
    }
    return true;
}

static size_t write_line(const uint8_t line, const uint8_t* const bytes, const size_t size)
{
    line_t* const self = &world.lines[line];
    if ((self->in.count == 0U) && (self->in.arrival < world.now + NATIVE_BYTE_TICKS)) {
        self->in.arrival = world.now + NATIVE_BYTE_TICKS;
    }
    size_t taken = 0;
    while ((taken < size) && (self->in.count < LINE_IN_MAX)) {
        line_in[line][(self->in.first + self->in.count++) % LINE_IN_MAX] = bytes[taken++];
    }
    return taken;
}

static size_t read_line(const uint8_t line, uint8_t* const bytes, const size_t size)
{
    line_t* const self = &world.lines[line];
    size_t given = 0;
    while ((given < size) && (self->out.count > 0U)) {
        bytes[given++] = line_out[line][self->out.first];
        self->out.first = (self->out.first + 1U) % LINE_OUT_MAX;
        self->out.count--;
    }
    return given;
}

size_t native_serial_write(const uint8_t* const bytes, const size_t size)
{
    return write_line(LINE_UART, bytes, size);
}

size_t native_serial_read(uint8_t* const bytes, const size_t size)
{
    return read_line(LINE_UART, bytes, size);
}

void native_usb_connect(const bool connected)
{
    world.usb_connected = connected;
    memset(&world.lines[LINE_USB], 0, sizeof world.lines[LINE_USB]);
    wake_cpu();
}

void native_usb_hold(const bool held)
{
    world.usb_held = held;
}

size_t native_usb_write(const uint8_t* const bytes, const size_t size)
{
    return world.usb_connected ? write_line(LINE_USB, bytes, size) : 0U;
}

size_t native_usb_read(uint8_t* const bytes, const size_t size)
{
    return read_line(LINE_USB, bytes, size);
}

size_t native_pins(native_transition_t* const drained, const size_t size)
{
    size_t given = 0;
    while ((given < size) && (world.transition_count > 0U)) {
        drained[given++] = transitions[world.transition_first];
        world.transition_first = (world.transition_first + 1U) % TRANSITIONS_MAX;
        world.transition_count--;
    }
    return given;
}

bool native_in_bootloader(void)
{
    return world.in_bootloader;
}

uint64_t native_tick(void)
{
    return world.now;
}

uint64_t native_boot_tick(void)
{
    return world.boot_tick;
}

uint8_t native_pin(const uint8_t pin)
{
    return (pin < PIN_COUNT) ? world.levels[pin] : 0U;
}

void native_stall_cpu(const uint64_t ticks)
{
    world.stalled_until = world.now + ticks;
    if (world.next_round < world.stalled_until) {
        world.next_round = world.stalled_until;
    }
}

void native_refuse_next(void)
{
    world.refuse_next = true;
}

void native_lost(native_lost_t* const lost)
{
    *lost = world.lost;
}

// ---- the controller's side: board.h ----

uint32_t board_tick(void)
{
    return (uint32_t)(world.now - world.boot_tick);
}

uint8_t board_boot(void)
{
    return world.boot;
}

uint8_t board_cause(void)
{
    return world.cause;
}

const uint8_t* board_name(void)
{
    static const uint8_t name[8] = "native";
    return name;
}

void board_watchdog_kick(void)
{
    world.kicked = world.now;
}

void board_reset(void)
{
    world.reset_wanted = true;
}

// The main loop never comes back; only power does.
void board_bootloader(void)
{
    outputs_at_rest();
    world.powered = false;
    world.in_bootloader = true;
}

bool board_connected(const uint8_t line)
{
    return (line == LINE_UART) || world.usb_connected;
}

size_t board_receive(const uint8_t line, uint8_t* const bytes, const size_t size)
{
    line_t* const self = &world.lines[line];
    const size_t given = (size < self->in.buffer_count) ? size : self->in.buffer_count;
    memcpy(bytes, self->in.buffer, given);
    self->in.buffer_count -= given;
    memmove(self->in.buffer, self->in.buffer + given, self->in.buffer_count);
    return given;
}

size_t board_transmit(const uint8_t line, const uint8_t* const bytes, const size_t size)
{
    line_t* const self = &world.lines[line];
    if (!board_connected(line)) {
        return size;
    }
    if (self->out.buffer_count == 0U) {
        self->out.departure = world.now + NATIVE_BYTE_TICKS;
    }
    size_t taken = 0;
    while ((taken < size) && (self->out.buffer_count < BUFFER_OUT_MAX)) {
        const size_t at = (self->out.buffer_first + self->out.buffer_count++) % BUFFER_OUT_MAX;
        self->out.buffer[at] = bytes[taken++];
    }
    return taken;
}

bool board_transmitted(const uint8_t line)
{
    return world.lines[line].out.buffer_count == 0U;
}

static bool is_refused(void)
{
    const bool refused = world.refuse_next;
    world.refuse_next = false;
    return refused;
}

bool board_flash_load(const board_flash_t* const flash)
{
    world.lamps.is_loaded = false;
    const bool lit = flash->lamp != LAMP_DARK;
    const bool outlasts = (uint64_t)flash->delay_ticks + flash->width_ticks > flash->holdoff_ticks;
    if (lit && ((flash->width_ticks > LAMP_WIDTH_MAX_TICKS) || outlasts || is_refused())) {
        return false;
    }
    world.lamps.loaded = *flash;
    world.lamps.is_loaded = true;
    return true;
}

bool board_edge(board_edge_t* const edge)
{
    if (world.lamps.edge_count == 0U) {
        return false;
    }
    *edge = world.lamps.edges[0];
    world.lamps.edge_count--;
    memmove(world.lamps.edges, world.lamps.edges + 1, world.lamps.edge_count * sizeof *edge);
    return true;
}

void board_lamps_cut(void)
{
    world.lamps.is_loaded = false;
    world.lamps.pin = 0;
    drive(PIN_PROJECTOR, 0);
    drive(PIN_LED, 0);
}

uint32_t board_edges_refused(void)
{
    return world.lamps.refused;
}

int32_t board_odometer(void)
{
    return world.odometer;
}

bool board_interlock_open(void)
{
    return world.levels[PIN_INTERLOCK] == 1U;
}

bool board_interlock_tripped(void)
{
    const bool tripped = world.interlock_tripped;
    world.interlock_tripped = false;
    return tripped;
}

bool board_microwave_starved(void)
{
    const bool starved = world.train.starved;
    world.train.starved = false;
    return starved;
}

void board_microwave(const bool enabled)
{
    world.train.enabled = enabled && !board_interlock_open();
    if (!enabled) {
        end_train();
    }
}

static int compare_steps(const void* const a, const void* const b)
{
    const int64_t first = ((const train_step_t*)a)->offset;
    const int64_t second = ((const train_step_t*)b)->offset;
    return (first > second) - (first < second);
}

static void add_step(const int64_t offset, const uint8_t pin, const uint8_t level)
{
    world.train.steps[world.train.step_count++] = (train_step_t){.offset = offset, .pin = pin, .level = level};
}

bool board_burst(const board_burst_t* const burst, uint32_t* const start)
{
    if (!world.train.enabled || is_refused()) {
        return false;
    }
    world.train.step_count = 0;
    uint8_t level = 0;
    for (uint16_t chip = 0; chip <= burst->length; chip++) {
        const bool on = (chip < burst->length) && ((burst->chips[chip / 8U] >> (chip % 8U)) & 1U);
        if (level != (on ? 1U : 0U)) {
            level = on ? 1U : 0U;
            add_step((int64_t)chip * burst->chip_ticks, PIN_MICROWAVE, level);
        }
    }
    const int64_t trigger = burst->trigger_offset;
    add_step(trigger, PIN_TRIGGER, 1);
    add_step(trigger + BOARD_TRIGGER_TICKS, PIN_TRIGGER, 0);
    const int64_t chips_end = (int64_t)burst->length * burst->chip_ticks;
    const int64_t trigger_end = trigger + BOARD_TRIGGER_TICKS;
    qsort(world.train.steps, world.train.step_count, sizeof world.train.steps[0], compare_steps);
    add_step((chips_end > trigger_end) ? chips_end : trigger_end, 0, 0);
    world.train.step = 0;
    world.train.done = 0;
    world.train.repeat = burst->repeat;
    world.train.period = burst->period_ticks;
    world.train.running = true;
    world.train.stopping = false;
    world.train.chip0 = world.now + NATIVE_ROUND_TICKS + (uint64_t)((trigger < 0) ? -trigger : 0);
    *start = (uint32_t)(world.train.chip0 - world.boot_tick);
    return true;
}

void board_burst_stop(void)
{
    world.train.stopping = true;
}

bool board_burst_running(uint16_t* const done)
{
    *done = world.train.done;
    return world.train.running;
}

void board_stage_move(const int32_t position, const uint32_t period_ticks, const bool hold)
{
    world.motor.target = position;
    world.motor.period = period_ticks;
    world.motor.hold = hold;
    world.motor.moving = true;
    world.motor.next =
        world.now + period_ticks;  // the driver wants direction and power some time before the first step
    drive(PIN_DIRECTION, (position >= world.motor.position) ? 1 : 0);
    drive(PIN_ENABLE, 0);
}

bool board_stage_moving(void)
{
    return world.motor.moving;
}

int32_t board_stage_position(void)
{
    return world.motor.position;
}

void board_status_light(const bool on)
{
    drive(PIN_STATUS, on ? 1 : 0);
}
