// Configurations: what is refused, and when a new one takes force.

#include <string.h>

#include "check.h"
#include "rig.h"

static reply_stage_t stage(const command_stage_t* const config)
{
    uint8_t payload[COMMAND_STAGE_LENGTH];
    command_stage_pack(config, payload);
    reply_stage_t reply;
    reply_stage_unpack(&reply, rig_command(COMMAND_STAGE, payload));
    return reply;
}

static void a_configuration_is_refused_as_a_whole_with_the_reason(void)
{
    rig_start();
    const command_stage_t good = rig_config(9, 4);
#define REFUSED(change, why, which)                                                                                    \
    do {                                                                                                               \
        command_stage_t config = good;                                                                                 \
        change;                                                                                                        \
        const reply_stage_t reply = stage(&config);                                                                    \
        EXPECT_EQ(reply.status, why);                                                                                  \
        EXPECT_EQ(reply.detail, which);                                                                                \
        EXPECT_EQ(rig_status().state& STATE_STAGED, 0);                                                                \
    } while (0)
    REFUSED(config.generation = 0, STATUS_OUT_OF_RANGE, 0);
    REFUSED(config.ratio = 16, STATUS_OUT_OF_RANGE, 1);
    REFUSED(config.frame_period = 2 * MS - 1, STATUS_OUT_OF_RANGE, 2);
    REFUSED(config.frame_period = 1000 * MS + 1, STATUS_OUT_OF_RANGE, 2);
    REFUSED(config.exposure = PERIOD + 1, STATUS_OUT_OF_RANGE, 3);
    REFUSED(config.readout = PERIOD + 1, STATUS_OUT_OF_RANGE, 4);
    REFUSED(config.tolerance = 0, STATUS_OUT_OF_RANGE, 5);
    REFUSED(config.tolerance = 501, STATUS_OUT_OF_RANGE, 5);
    REFUSED(config.host_timeout = 49, STATUS_OUT_OF_RANGE, 6);
    REFUSED(config.host_timeout = 5001, STATUS_OUT_OF_RANGE, 6);
    REFUSED(config.projector_width = 20 * MS + 1, STATUS_OUT_OF_RANGE, 8);
    REFUSED(config.led_width = 20 * MS + 1, STATUS_OUT_OF_RANGE, 10);
    REFUSED(config.projector_delay = 2 * MS - 1, STATUS_WINDOW, LAMP_PROJECTOR);
    REFUSED(config.projector_delay = 10 * MS + 1, STATUS_WINDOW, LAMP_PROJECTOR);
    REFUSED(config.projector_delay = 0xFFFFFFFF, STATUS_WINDOW, LAMP_PROJECTOR);
    REFUSED(config.led_delay = 1 * MS, STATUS_WINDOW, LAMP_LED);
    REFUSED(config.led_delay = 7 * MS + 1, STATUS_WINDOW, LAMP_LED);
    REFUSED(config.exposure = config.readout, STATUS_WINDOW, LAMP_PROJECTOR);  // no instant at which all rows expose
    // A global shutter leaves the window open, so the duty is what limits: 20 of 39 ms.
    REFUSED((config.frame_period = 39 * MS, config.exposure = 39 * MS, config.readout = 0, config.led_delay = 0,
             config.led_width = 20 * MS),
            STATUS_DUTY, LAMP_LED);
    REFUSED((config.frame_period = 39 * MS, config.exposure = 39 * MS, config.readout = 0, config.projector_delay = 0,
             config.projector_width = 20 * MS),
            STATUS_DUTY, LAMP_PROJECTOR);
    // It is a share of the shortest interval the tolerance lets through, for edges may come that early every time.
    REFUSED((config.tolerance = 500, config.exposure = PERIOD, config.readout = 0, config.led_delay = 0,
             config.led_width = 10 * MS + 1),
            STATUS_DUTY, LAMP_LED);
    // The flash has to be over before the earliest edge that would be accepted: 2 % early is 39.2 ms.
    REFUSED((config.exposure = PERIOD, config.readout = 0, config.led_delay = 34 * MS + 200 * US + 1), STATUS_WINDOW,
            LAMP_LED);
    EXPECT_EQ(rig_status_of(COMMAND_COMMIT, (const uint8_t[]){9}), STATUS_BAD_STATE);
    EXPECT_EQ(rig_status().generation, 0);
}

static void the_window_is_where_all_rows_expose(void)
{
    rig_start();
    command_stage_t config = rig_config(9, 4);
    config.projector_delay = 2 * MS;  // exactly filling it
    config.projector_width = 10 * MS;
    const reply_stage_t reply = stage(&config);
    EXPECT_EQ(reply.status, STATUS_OK);
    EXPECT_EQ(reply.generation, 9);
    EXPECT_EQ(reply.window_open, 2 * MS);
    EXPECT_EQ(reply.window_close, 12 * MS);
    config.projector_delay += 1;
    EXPECT_EQ(stage(&config).status, STATUS_WINDOW);
    config.ratio = 0;  // LED only: the projector's numbers do not matter
    EXPECT_EQ(stage(&config).status, STATUS_OK);
    config.exposure = PERIOD;
    config.readout = 0;
    config.led_delay = 34 * MS + 200 * US;
    EXPECT_EQ(stage(&config).window_close, 39 * MS + 200 * US);
}

static void a_commit_needs_the_staged_generation(void)
{
    rig_start();
    EXPECT_EQ(rig_status_of(COMMAND_COMMIT, (const uint8_t[]){1}), STATUS_BAD_STATE);
    command_stage_t config = rig_config(3, 4);
    EXPECT_EQ(stage(&config).status, STATUS_OK);
    EXPECT(rig_status().state & STATE_STAGED);
    EXPECT_EQ(rig_status_of(COMMAND_COMMIT, (const uint8_t[]){4}), STATUS_BAD_STATE);
    EXPECT_EQ(rig_status().generation, 0);
    EXPECT_EQ(rig_status_of(COMMAND_COMMIT, (const uint8_t[]){3}), STATUS_OK);
    EXPECT_EQ(rig_status().generation, 3);
    EXPECT_EQ(rig_status().state & STATE_STAGED, 0);
    EXPECT_EQ(rig_status_of(COMMAND_COMMIT, (const uint8_t[]){3}), STATUS_BAD_STATE);
}

static void a_commit_while_armed_takes_force_at_slot_0_and_never_within_a_cycle(void)
{
    for (uint32_t at = 1; at <= 5; at++) {
        rig_scan(4);
        for (uint32_t i = 0; i < at; i++) {
            rig_edge(PERIOD);
        }
        command_stage_t config = rig_config(2, 2);
        config.projector_width = 1 * MS;
        config.led_width = 1 * MS;
        rig_configure(&config);
        EXPECT_EQ(rig_status().generation, 1);
        config.generation = 7;
        EXPECT_EQ(stage(&config).status, STATUS_BAD_STATE);  // what waits must not change
        for (uint32_t i = at; i < 12; i++) {
            rig_edge(PERIOD);
        }
        // The cycle in which the commit came is finished; the flash after its last edge's successor is the first new
        // one.
        const uint32_t first_new = (at < 5) ? 5 : 10;
        for (uint32_t i = 0; i < 12; i++) {
            const event_edge_t edge = rig_take_edge();
            const bool fresh = i >= first_new;
            EXPECT_EQ(edge.generation, fresh ? 2 : 1);
            EXPECT_EQ(edge.slot, fresh ? (i - first_new) % 3 : i % 5);
            EXPECT_EQ(edge.lamp, edge.slot == (fresh ? 2 : 4) ? LAMP_LED : LAMP_PROJECTOR);
            EXPECT_EQ(rig_fall((edge.lamp == LAMP_LED) ? PIN_LED : PIN_PROJECTOR, 0) != 0, 1);
        }
        event_configured_t configured;
        event_configured_unpack(&configured, rig_take(EVENT_CONFIGURED)->payload);
        EXPECT_EQ(configured.edge, first_new);
        EXPECT_EQ(configured.generation, 2);
        EXPECT_EQ(rig_count(EVENT_CONFIGURED), 0);
    }
}

static void a_commit_waiting_while_disarmed_takes_force_at_once(void)
{
    rig_scan(4);
    rig_edge(PERIOD);
    const command_stage_t config = rig_config(2, 1);
    rig_configure(&config);
    EXPECT_EQ(rig_status().generation, 1);
    rig_arm(0);
    EXPECT_EQ(rig_status().generation, 2);
}

void configuration_tests(void)
{
    RUN(a_configuration_is_refused_as_a_whole_with_the_reason);
    RUN(the_window_is_where_all_rows_expose);
    RUN(a_commit_needs_the_staged_generation);
    RUN(a_commit_while_armed_takes_force_at_slot_0_and_never_within_a_cycle);
    RUN(a_commit_waiting_while_disarmed_takes_force_at_once);
}
