// Bursts: chips to the tick, trains, the digitizer trigger, and what must never be sent.

#include <string.h>

#include "rig.h"
#include "check.h"

static void start_armed(void)
{
    rig_start();
    rig_arm(ARM_MICROWAVE);
    rig_forget();
}

static command_burst_t train(const uint8_t code)
{
    return (command_burst_t){.code = code, .chip = 50, .repeat = 1, .period = 100 * 1000, .trigger_offset = 0};
}

static reply_burst_t fire(const command_burst_t* const command)
{
    uint8_t payload[COMMAND_BURST_LENGTH];
    command_burst_pack(command, payload);
    reply_burst_t reply;
    reply_burst_unpack(&reply, rig_command(COMMAND_BURST, payload));
    return reply;
}

static uint8_t upload(const char* const chips, const uint16_t length)
{
    command_pattern_t pattern = {.length = length};
    for (uint16_t i = 0; chips[i] != '\0'; i++) {
        pattern.chips[i / 8U] |= (uint8_t)((chips[i] == '1') << (i % 8U));
    }
    uint8_t payload[COMMAND_PATTERN_LENGTH];
    command_pattern_pack(&pattern, payload);
    return rig_status_of(COMMAND_PATTERN, payload);
}

// The gate during the chips of a burst, sampled amid each of them from the transitions.
static void expect_chips(const uint64_t start, const char* const chips, const uint64_t chip_ticks)
{
    size_t rises = rig_rises(PIN_MICROWAVE);
    size_t pulse = 0;
    const size_t length = strlen(chips);
    for (size_t i = 0; i < length; i++) {
        const bool begins = (chips[i] == '1') && ((i == 0U) || (chips[i - 1U] == '0'));
        const bool ends = (chips[i] == '1') && ((i + 1U == length) || (chips[i + 1U] == '0'));
        if (begins) {
            EXPECT_EQ(rig_rise(PIN_MICROWAVE, pulse), start + i * chip_ticks);
        }
        if (ends) {
            EXPECT_EQ(rig_fall(PIN_MICROWAVE, pulse), start + (i + 1U) * chip_ticks);
            pulse++;
        }
    }
    EXPECT_EQ(rises, pulse);
}

static void built_in_codes_are_sent_chip_by_chip_to_the_tick(void)
{
    static const struct {
        uint8_t code;
        const char* chips;
    } codes[] = {
        {BURST_CODE_SINGLE, "1"},
        {BURST_CODE_MPSL25, "1001001010100000011100111"},
        {BURST_CODE_MPSL25_STUFFED, "10000010000010001000100000000000001010100000101010"},
        {BURST_CODE_BARKER13, "1111100110101"},
        {BURST_CODE_MANCHESTER1, "0101011010010101100110100110011001101001011001010101"},
        {BURST_CODE_MANCHESTER2, "0101010110010110100110010101010110011010100101101010"},
    };
    for (size_t i = 0; i < sizeof codes / sizeof codes[0]; i++) {
        start_armed();
        const command_burst_t command = train(codes[i].code);
        const reply_burst_t reply = fire(&command);
        EXPECT_EQ(reply.status, STATUS_OK);
        EXPECT_EQ(reply.length, strlen(codes[i].chips));
        expect_chips(native_boot_tick() + reply.start, codes[i].chips, 50);
        EXPECT_EQ(rig_rise(PIN_TRIGGER, 0), native_boot_tick() + reply.start);
        event_burst_done_t done;
        event_burst_done_unpack(&done, rig_take(EVENT_BURST_DONE)->payload);
        EXPECT_EQ(done.done, 1);
        EXPECT_EQ(done.fault, FAULT_NONE);
    }
}

static void an_uploaded_pattern_of_256_chips_is_sent_as_it_is(void)
{
    start_armed();
    char chips[257];
    memset(chips, '0', 256);
    chips[0] = chips[1] = chips[100] = chips[254] = chips[255] = '1';
    chips[256] = '\0';
    EXPECT_EQ(upload(chips, 256), STATUS_OK);
    command_burst_t command = train(BURST_CODE_UPLOADED);
    command.chip = 30;
    const reply_burst_t reply = fire(&command);
    EXPECT_EQ(reply.length, 256);
    expect_chips(reply.start, chips, 30);
}

static void an_all_dark_pattern_still_triggers(void)
{
    start_armed();
    EXPECT_EQ(upload("00000", 5), STATUS_OK);
    const command_burst_t command = train(BURST_CODE_UPLOADED);
    EXPECT_EQ(fire(&command).status, STATUS_OK);
    EXPECT_EQ(rig_rises(PIN_MICROWAVE), 0);
    EXPECT_EQ(rig_rises(PIN_TRIGGER), 1);
}

static void trains_keep_their_period_and_trigger_offset_to_the_tick(void)
{
    const int32_t offsets[] = {0, 7, 5000, -1, -9000, 99900, -98750};
    for (size_t i = 0; i < sizeof offsets / sizeof offsets[0]; i++) {
        start_armed();
        command_burst_t command = train(BURST_CODE_MPSL25);
        command.repeat = 10;
        command.trigger_offset = offsets[i];
        const reply_burst_t reply = fire(&command);
        EXPECT_EQ(reply.status, STATUS_OK);
        EXPECT(rig_status().state & STATE_BURST_RUNNING);
        rig_pass(20 * MS);
        EXPECT_EQ(rig_rises(PIN_TRIGGER), 10);
        EXPECT_EQ(rig_rises(PIN_MICROWAVE), 70);  // MPSL25 has 7 runs of ones
        for (size_t shot = 0; shot < 10; shot++) {
            const uint64_t chip0 = reply.start + shot * 100000;
            EXPECT_EQ(rig_rise(PIN_MICROWAVE, shot * 7), chip0);
            EXPECT_EQ((int64_t)(rig_rise(PIN_TRIGGER, shot) - chip0), offsets[i]);
            EXPECT_EQ(rig_fall(PIN_TRIGGER, shot) - rig_rise(PIN_TRIGGER, shot), 100);
        }
        event_burst_done_t done;
        event_burst_done_unpack(&done, rig_take(EVENT_BURST_DONE)->payload);
        EXPECT_EQ(done.done, 10);
        EXPECT_EQ(rig_status().state & STATE_BURST_RUNNING, 0);
    }
}

static void a_stopped_train_ends_after_a_whole_burst(void)
{
    start_armed();
    command_burst_t command = train(BURST_CODE_MPSL25);
    command.repeat = 1000;
    EXPECT_EQ(fire(&command).status, STATUS_OK);
    EXPECT_EQ(fire(&command).status, STATUS_BAD_STATE);
    EXPECT_EQ(upload("1", 1), STATUS_BAD_STATE);
    rig_pass(10 * MS);
    EXPECT_EQ(rig_status_of(COMMAND_BURST_STOP, NULL), STATUS_OK);
    rig_pass(5 * MS);
    event_burst_done_t done;
    event_burst_done_unpack(&done, rig_take(EVENT_BURST_DONE)->payload);
    EXPECT(done.done > 10U && done.done < 20U);
    EXPECT_EQ(rig_rises(PIN_MICROWAVE), done.done * 7U);
    EXPECT_EQ(rig_rises(PIN_TRIGGER), done.done);
    reply_burst_stop_t stop;
    reply_burst_stop_unpack(&stop, rig_command(COMMAND_BURST_STOP, NULL));  // nothing runs: harmless
    EXPECT_EQ(stop.done, done.done);
    command.repeat = 1;
    EXPECT_EQ(fire(&command).status, STATUS_OK);
}

// In the gap no further burst is sent, however long it is, and before the first burst that one is.
static void a_train_stopped_between_bursts_ends_at_once(void)
{
    start_armed();
    command_burst_t command = train(BURST_CODE_MPSL25);
    command.repeat = 1000;
    command.period = 100 * MS;
    command.trigger_offset = 2000;
    EXPECT_EQ(fire(&command).status, STATUS_OK);
    EXPECT_EQ(rig_status_of(COMMAND_BURST_STOP, NULL), STATUS_OK);
    event_burst_done_t done;
    event_burst_done_unpack(&done, rig_take(EVENT_BURST_DONE)->payload);
    EXPECT_EQ(done.done, 1);
    rig_pass(200 * MS);
    EXPECT_EQ(rig_rises(PIN_MICROWAVE), 7);
    EXPECT_EQ(rig_rises(PIN_TRIGGER), 1);
    rig_forget();
    command.trigger_offset = -90 * (int32_t)MS;
    EXPECT_EQ(fire(&command).status, STATUS_OK);
    EXPECT_EQ(rig_status_of(COMMAND_BURST_STOP, NULL), STATUS_OK);
    EXPECT_EQ(rig_rises(PIN_TRIGGER), 1);
    rig_send(COMMAND_PING, 0, NULL);
    rig_pass(300 * MS);
    EXPECT_EQ(rig_count(EVENT_BURST_DONE), 1);
    EXPECT_EQ(rig_rises(PIN_MICROWAVE), 7);
    EXPECT_EQ(rig_rises(PIN_TRIGGER), 1);
}

static void disarming_cuts_the_train_at_once(void)
{
    start_armed();
    command_burst_t command = train(BURST_CODE_MPSL25);
    command.repeat = 1000;
    EXPECT_EQ(fire(&command).status, STATUS_OK);
    rig_pass(3 * MS);
    rig_arm(0);
    rig_forget();
    rig_pass(10 * MS);
    EXPECT_EQ(rig_rises(PIN_MICROWAVE) + rig_rises(PIN_TRIGGER), 0);
    EXPECT_EQ(fire(&command).status, STATUS_BAD_STATE);
}

static void trains_beyond_a_limit_are_refused_with_the_reason(void)
{
    start_armed();
    const command_burst_t good = train(BURST_CODE_MPSL25);
#define REFUSED(change, why, which)                                                                                    \
    do {                                                                                                               \
        command_burst_t command = good;                                                                                \
        change;                                                                                                        \
        const reply_burst_t reply = fire(&command);                                                                    \
        EXPECT_EQ(reply.status, why);                                                                                  \
        EXPECT_EQ(reply.detail, which);                                                                                \
        EXPECT_EQ(rig_status().state& STATE_BURST_RUNNING, 0);                                                         \
    } while (0)
    REFUSED(command.code = BURST_CODE_UPLOADED, STATUS_BAD_STATE, 0);  // nothing uploaded yet
    REFUSED(command.code = 7, STATUS_OUT_OF_RANGE, 0);
    REFUSED(command.chip = 9, STATUS_OUT_OF_RANGE, 1);
    REFUSED(command.chip = 3001, STATUS_OUT_OF_RANGE, 1);
    REFUSED(command.repeat = 0, STATUS_OUT_OF_RANGE, 2);
    REFUSED(command.period = 25 * 50 + 49, STATUS_OUT_OF_RANGE, 3);
    REFUSED(command.period = 100000001, STATUS_OUT_OF_RANGE, 3);
    EXPECT_EQ(upload("0", 1), STATUS_OK);
    REFUSED((command.code = BURST_CODE_UPLOADED, command.period = 599), STATUS_OUT_OF_RANGE, 3);
    REFUSED(command.trigger_offset = -(100000 - 1250) - 1, STATUS_OUT_OF_RANGE, 4);
    REFUSED(command.trigger_offset = 100000 - 99, STATUS_OUT_OF_RANGE, 4);
    REFUSED(command.chip = 29, STATUS_PULSE_WIDTH, 0);                                 // 0.29 us
    REFUSED((command.chip = 1001, command.period = 10000000), STATUS_PULSE_WIDTH, 0);  // three ones: 30.03 us
    REFUSED(command.period = 11 * 50 * 20 - 1, STATUS_DUTY, 3);                        // 11 ones of 50 ticks at 5 %
    REFUSED((command.code = BURST_CODE_SINGLE, command.chip = 29), STATUS_PULSE_WIDTH, 0);  // also the last chip
    command_burst_t exact = good;
    exact.period = 11 * 50 * 20;
    EXPECT_EQ(fire(&exact).status, STATUS_OK);
}

static void an_upload_is_checked(void)
{
    start_armed();
    EXPECT_EQ(upload("", 0), STATUS_OUT_OF_RANGE);
    EXPECT_EQ(upload("1", 257), STATUS_OUT_OF_RANGE);
    EXPECT_EQ(upload("1010001", 6), STATUS_OUT_OF_RANGE);  // a one past the end
    const command_burst_t command = train(BURST_CODE_UPLOADED);
    EXPECT_EQ(fire(&command).status, STATUS_BAD_STATE);
    EXPECT_EQ(upload("1010001", 7), STATUS_OK);
    EXPECT_EQ(fire(&command).length, 7);
}

static uint64_t on_between(const uint64_t from, const uint64_t to)
{
    uint64_t on = 0;
    for (size_t pulse = 0; pulse < rig_rises(PIN_MICROWAVE); pulse++) {
        const uint64_t rise = rig_rise(PIN_MICROWAVE, pulse);
        if ((rise >= from) && (rise < to)) {
            on += rig_fall(PIN_MICROWAVE, pulse) - rise;
        }
    }
    return on;
}

// What one train may not, a row of them may not either: 30 us every 600 us are the limit, and were sent 12 times as
// densely by asking again and again.
static void the_duty_limit_holds_over_trains_and_arming(void)
{
    static const uint8_t none = 0;
    static const uint8_t microwave = ARM_MICROWAVE;
    const command_burst_t single = {.code = BURST_CODE_SINGLE, .chip = 3000, .repeat = 1, .period = 60000};
    uint8_t payload[COMMAND_BURST_LENGTH];
    command_burst_pack(&single, payload);
    rig_start();
    rig_arm(ARM_MICROWAVE);
    rig_forget();
    uint32_t refused = 0;
    for (uint8_t i = 0; i < 200U; i++) {
        rig_send(COMMAND_BURST, i, payload);
        if ((i % 5U) == 4U) {
            rig_send(COMMAND_ARM, i, &none);
        }
        rig_send(COMMAND_CLEAR, i, NULL);
        rig_send(COMMAND_ARM, (uint8_t)(i + 100U), &microwave);
        rig_pass((100U + 37U * (i % 20U)) * US);
    }
    for (const got_t* got = rig_take(EVENT_FAULT); got != NULL; got = rig_take(EVENT_FAULT)) {
        event_fault_t fault;
        event_fault_unpack(&fault, got->payload);
        EXPECT_EQ(fault.fault, FAULT_LIMIT);
        EXPECT_EQ(fault.detail, 3);
        refused++;
    }
    const size_t pulses = rig_rises(PIN_MICROWAVE);
    EXPECT(refused > 20U);
    EXPECT(pulses > 20U);
    for (size_t first = 0; first < pulses; first++) {
        for (size_t last = first + 1U; last < pulses; last++) {
            const uint64_t from = rig_rise(PIN_MICROWAVE, first);
            const uint64_t to = rig_rise(PIN_MICROWAVE, last);
            EXPECT(20U * on_between(from, to) <= to - from);
        }
    }
}

// 64 pulses of 30 us owe 38.4 ms of dark, whatever happens in between; and so does a controller that was reset.
static void a_train_that_comes_too_soon_stays_dark_and_says_why(void)
{
    start_armed();
    char chips[129] = {0};
    for (size_t i = 0; i < 128U; i++) {
        chips[i] = ((i % 2U) == 0U) ? '1' : '0';
    }
    EXPECT_EQ(upload(chips, 128), STATUS_OK);
    const command_burst_t command = {
        .code = BURST_CODE_UPLOADED, .chip = 3000, .repeat = 1, .period = 3840 * 1000, .trigger_offset = 0};
    const reply_burst_t first = fire(&command);
    EXPECT_EQ(first.status, STATUS_OK);
    rig_pass(10 * MS);
    rig_arm(0);
    rig_arm(ARM_MICROWAVE);
    rig_forget();
    reply_burst_t reply = fire(&command);
    EXPECT_EQ(reply.status, STATUS_DUTY);
    EXPECT_EQ(reply.detail, 3);
    event_fault_t fault;
    event_fault_unpack(&fault, rig_take(EVENT_FAULT)->payload);
    EXPECT_EQ(fault.fault, FAULT_LIMIT);
    EXPECT_EQ(fault.detail, 3);
    EXPECT_EQ(rig_status_of(COMMAND_CLEAR, NULL), STATUS_OK);
    rig_arm(ARM_MICROWAVE);
    native_run_until(native_boot_tick() + first.start + command.period - 10 * US);
    EXPECT_EQ(rig_rises(PIN_MICROWAVE) + rig_rises(PIN_TRIGGER), 0);
    EXPECT_EQ(fire(&command).status, STATUS_OK);
    native_run_until(native_tick() + 21000 * MS);  // half a turn of the tick later nothing is owed
    EXPECT_EQ(rig_status_of(COMMAND_CLEAR, NULL), STATUS_OK);
    rig_arm(ARM_MICROWAVE);
    EXPECT_EQ(fire(&command).status, STATUS_OK);
    uint8_t magic[COMMAND_RESET_LENGTH];
    command_reset_pack(&(command_reset_t){.magic = RESET_MAGIC}, magic);
    EXPECT_EQ(rig_status_of(COMMAND_RESET, magic), STATUS_OK);
    rig_pass(2 * MS);
    uint8_t payload[COMMAND_IDENTIFY_LENGTH];
    command_identify_pack(&(command_identify_t){.protocol = PROTOCOL_VERSION, .schema = SCHEMA_HASH}, payload);
    EXPECT_EQ(rig_status_of(COMMAND_IDENTIFY, payload), STATUS_OK);
    rig_arm(ARM_MICROWAVE);
    EXPECT_EQ(upload(chips, 128), STATUS_OK);
    EXPECT_EQ(fire(&command).status, STATUS_DUTY);
}

void bursts_tests(void)
{
    RUN(built_in_codes_are_sent_chip_by_chip_to_the_tick);
    RUN(an_uploaded_pattern_of_256_chips_is_sent_as_it_is);
    RUN(an_all_dark_pattern_still_triggers);
    RUN(trains_keep_their_period_and_trigger_offset_to_the_tick);
    RUN(a_stopped_train_ends_after_a_whole_burst);
    RUN(a_train_stopped_between_bursts_ends_at_once);
    RUN(disarming_cuts_the_train_at_once);
    RUN(trains_beyond_a_limit_are_refused_with_the_reason);
    RUN(an_upload_is_checked);
    RUN(the_duty_limit_holds_over_trains_and_arming);
    RUN(a_train_that_comes_too_soon_stays_dark_and_says_why);
}
