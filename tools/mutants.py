"""Puts named faults into copies of the firmware, builds each, and expects the emulator's tests to catch every one.

python tools/mutants.py [NAME ..]        needs what `make test` installs; about 10 s a mutant
"""

import os
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]


@dataclass(frozen=True, slots=True)
class Mutant:
    """One line of the firmware gone wrong. `tests`: the pytest expression that should notice, kept narrow for speed."""

    name: str
    file: str
    right: str
    wrong: str
    tests: str


MUTANTS = (
    Mutant(
        "chip-of-49-ticks",
        "core/bursts.c",
        ".chip_ticks = command->chip,",
        ".chip_ticks = (uint16_t)(command->chip - 1U),",
        "code_is_played and SINGLE or code_is_played and MPSL25",
    ),
    Mutant(
        "missing-un-reset",
        "rp2040/start.c",
        "RESET_PIO0 | RESET_PIO1 | RESET_TIMER |",
        "RESET_PIO0 | RESET_TIMER |",
        "boots",
    ),
    Mutant("pads-left-at-reset", "rp2040/pinuse.c", "    REGISTER(PAD(pin)) = pad;\n", "    (void)pad;\n", "boots"),
    Mutant(
        "swapped-lamps",
        "rp2040/lamps.c",
        "(flash->lamp == LAMP_LED) ? 1U <<",
        "(flash->lamp != LAMP_LED) ? 1U <<",
        "order",
    ),
    Mutant(
        "slot-off-by-one",
        "core/sequencer.c",
        "return slot == config->ratio;",
        "return slot + 1U == config->ratio;",
        "order",
    ),
    Mutant(
        "width-in-the-wrong-lamp",
        "core/sequencer.c",
        "plan.width_ticks = led ? self->config.led_width : self->config.projector_width;",
        "plan.width_ticks = led ? self->config.projector_width : self->config.led_width;",
        "order",
    ),
    Mutant("crc-without-xorout", "core/link.c", "^ 0xFFFFU", "^ 0x0000U", "boots"),
    Mutant(
        "interlock-ignored-in-a-burst",
        "rp2040/microwave.c",
        "JMP_PIN(GUARD_CUT),",
        "MOV_ISR_NULL,",
        "interlock",
    ),
    Mutant(
        "a-second-reread-takes-the-place-of-the-first",
        "core/events.c",
        "(uint8_t)((rereads->oldest + rereads->waiting) % REREADS_MAX)",
        "rereads->oldest",
        "every_event_promised",
    ),
    Mutant("event-sequence-not-advanced", "core/events.c", "self->next++", "self->next += 0U", "gap"),
    Mutant(
        "lamp-one-tick-late",
        "rp2040/lamps.c",
        "    MOV_ISR_OSR | DELAY(1U),",
        "    MOV_ISR_OSR | DELAY(3U),",
        "one_constant",
    ),
    Mutant(
        "width-one-tick-long",
        "rp2040/lamps.c",
        "flash->width_ticks - LAMP_WIDTH_MIN_TICKS : 0U",
        "flash->width_ticks - LAMP_WIDTH_MIN_TICKS + 1U : 0U",
        "widths",
    ),
    Mutant(
        "hold-off-ignored",
        "rp2040/lamps.c",
        "(ticks > HOLDOFF_OVERHEAD) ? (ticks - HOLDOFF_OVERHEAD) / 2U : 0U",
        "(ticks > HOLDOFF_OVERHEAD) ? 100U : 0U",
        "glitches",
    ),
    Mutant(
        "watchdog-never-started",
        "rp2040/reset.c",
        "    SET_BITS(WATCHDOG_CTRL) = WATCHDOG_ENABLE;\n",
        "",
        "stuck",
    ),
    Mutant(
        "trigger-off-by-one",
        "rp2040/microwave.c",
        "TRIGGER_MACHINE, (uint32_t)(first_end(&trigger) - lead),",
        "TRIGGER_MACHINE, (uint32_t)(first_end(&trigger) - lead + 1),",
        "code_is_played and SINGLE",
    ),
    Mutant("usb-toggle-wrong", "rp2040/usbdata.c", "    in.data1 = !in.data1;\n", "", "both_lines"),
    Mutant("usb-handed-over-too-soon", "rp2040/usbdata.c", "nop\\n", "", "enumerates"),
    Mutant(
        "usb-no-empty-packet", "rp2040/usbdata.c", "((in.filled > 0U) || in.whole)", "(in.filled > 0U)", "last_packet"
    ),
    Mutant(
        "usb-one-buffer-for-two-packets",
        "rp2040/usbdata.c",
        "    in.buffer = (in.buffer == DATA_IN) ? DATA_IN_SECOND : DATA_IN;\n",
        "",
        "handed_over",
    ),
    Mutant(
        "usb-late-in-a-frame",
        "rp2040/usbframe.c",
        "- frame.began_us < EARLY_US",
        "- frame.began_us < 980U",
        "handed_over",
    ),
    Mutant(
        "usb-frame-taken-for-young",
        "rp2040/usbframe.c",
        "frame.began_us = frame.looked_us;",
        "frame.began_us = now_us;",
        "late_round",
    ),
    Mutant("usb-hang-not-seen", "rp2040/usb.c", "&& usb_frame_overdue()", "&& false", "usb_block_hangs and quiet"),
    Mutant(
        "usb-hang-without-a-reset",
        "rp2040/usb.c",
        "    SET_BITS(RESETS_RESET) = RESET_USB;\n",
        "",
        "usb_block_hangs and quiet",
    ),
    Mutant("usb-hang-not-counted", "rp2040/usb.c", "    recovery.times++;\n", "", "usb_block_hangs and quiet"),
    Mutant("usb-impatient-with-a-host", "rp2040/usbframe.c", "WAKE_US 100000U", "WAKE_US 20000U", "awakening"),
    Mutant(
        "usb-address-too-early",
        "rp2040/usb.c",
        "        control.address = (uint8_t)(setup->value & 0x7FU);\n",
        "        REGISTER(USB_ADDRESS) = setup->value & 0x7FU;\n",
        "enumerates",
    ),
    Mutant(
        "unplugged-host-not-noticed",
        "core/safety.c",
        "!board_connected(self->session) ||",
        "",
        "unplugged or closed_port",
    ),
    Mutant(
        "any-line-commands",
        "core/commands.h",
        "return self->schema_ok && (line == self->session);",
        "return self->schema_ok || (line == self->session);",
        "both_lines",
    ),
    Mutant(
        "boot-loader-while-armed",
        "core/commands.c",
        "const bool busy = (self->armed != 0U) || self->turntable.moving;",
        "const bool busy = self->turntable.moving;",
        "boot_loader",
    ),
    Mutant(
        "outputs-not-off-before-the-boot-loader",
        "rp2040/reset.c",
        "SET_BITS(RESETS_RESET) = RESET_PIO0 | RESET_PIO1;",
        "REGISTER(SIO_GPIO_OUT_SET) = 1U << PIN_STATUS;",
        "boot_loader",
    ),
    Mutant("credit-not-enforced", "rp2040/microwave.c", "JMP_X_NOT_Y(GUARD_TAKE),", "JMP(GUARD_TAKE),", "stuck"),
    Mutant("credit-twice-as-long", "rp2040/microwave.c", "#define CREDIT 100000U", "#define CREDIT 200000U", "stuck"),
    Mutant(
        "an-old-host-hears-what-is-new",
        "core/events.c",
        "if (fault_since(fault.fault) > level) {",
        "if (fault_since(fault.fault) > level + 1U) {",
        "host_of_level_1",
    ),
    Mutant(
        "crash-forgotten-at-start",
        "rp2040/crash.c",
        "if ((cause == BOOT_CAUSE_POWER_ON) ||",
        "if ((cause != BOOT_CAUSE_HOST_RESET) ||",
        "hung",
    ),
    Mutant(
        "alarm-after-the-watchdog", "rp2040/reset.c", "BOARD_WATCHDOG_MS * 800U", "BOARD_WATCHDOG_MS * 1200U", "hung"
    ),
    Mutant(
        "hard-fault-waits-for-the-watchdog",
        "rp2040/crash.c",
        "    SET_BITS(WATCHDOG_CTRL) = WATCHDOG_TRIGGER;\n",
        "",
        "hard_fault",
    ),
    Mutant(
        "crash-outlives-the-power",
        "rp2040/crash.c",
        "if ((cause == BOOT_CAUSE_POWER_ON) ||",
        "if (",
        "short_loss_of_power",
    ),
    Mutant(
        "boot-without-chance",
        "rp2040/identity.c",
        "nonce = (nonce << 16) | random_16();",
        "nonce = 0x00070007U;",
        "ring_oscillator or nonce_of_another",
    ),
    Mutant(
        "duty-of-the-configured-period",
        "core/sequencer.c",
        "const uint32_t next_edge = holdoff_ticks(config);",
        "const uint32_t next_edge = config->frame_period;",
        "shortest_interval",
    ),
    Mutant(
        "ticks-compared-without-sign",
        "core/sequencer.c",
        "(ticks_since(now, self->last_tick) <= (int32_t)(period / 2U * 5U))",
        "(now - self->last_tick <= period / 2U * 5U)",
        "no_lost_sync",
    ),
    Mutant(
        "duty-not-charged",
        "rp2040/microwave.c",
        "        duty_charge(&owed, train.rise, train.on_ticks, MICROWAVE_DUTY_MAX_PERMILLE);\n",
        "",
        "duty_limit_whatever",
    ),
    Mutant(
        "trigger-goes-on-alone",
        "rp2040/microwave.c",
        "        trigger_list[0] = LOW_FOR_EVER;\n",
        "",
        "stopped_at_any and 600-400",
    ),
    Mutant(
        "ends-in-the-middle-of-a-reading",
        "rp2040/microwave.c",
        "const bool is_time = tick_is_past(now, from) && !tick_is_past(now, until);",
        "const bool is_time = tick_is_past(now, from) || !tick_is_past(now, until);",
        "stopped_at_any and 600",
    ),
    Mutant(
        "trigger-last-in-its-list",
        "rp2040/microwave.c",
        "    list->begin = has_tail ? begin : list->last_fall - (int32_t)period;\n",
        "    list->begin = begin;\n",
        "stopped_at_any and 600",
    ),
    Mutant(
        "turntable-through-the-interlock",
        "core/safety.c",
        "    if ((self->armed == 0U) && !self->turntable.moving) {",
        "    if (self->armed == 0U) {",
        "ends_it",
    ),
    Mutant(
        "turntable-deaf-to-disarming",
        "core/safety.c",
        "        turntable_stop(&self->turntable, STOP_CAUSE_STOPPED);\n",
        "",
        "brakes_along and disarm",
    ),
    Mutant(
        "cut-step-miscounted",
        "rp2040/turntable.c",
        "const bool before_rise = (at == LAMP_DELAY) || (at == LAMP_DELAY + 1U);",
        "const bool before_rise = false && at;",
        "opened_interlock_ends",
    ),
    Mutant(
        "short-touch-missed",
        "rp2040/pinuse.c",
        "    ends_touched = ends_touched | ends;\n",
        "",
        "however_short",
    ),
    Mutant(
        "braking-too-late",
        "core/turntable.c",
        "(made < left) ? made : left",
        "made",
        "speeds_up",
    ),
    Mutant(
        "no-soft-limit",
        "core/turntable.c",
        "(command->position < self->config.lowest) || (command->position > self->config.highest)",
        "false",
        "beyond_the_limits",
    ),
    Mutant(
        "nothing-owed-after-a-reset",
        "rp2040/microwave.c",
        ".owing = board_cause() != BOOT_CAUSE_POWER_ON",
        ".owing = false",
        "owes_is_paid",
    ),
    Mutant(
        "look-one-tick-late",
        "rp2040/measure.c",
        "        JMP_X_DEC(MEASURE_PROGRAM + 3U),",
        "        JMP_X_DEC(MEASURE_PROGRAM + 3U) | DELAY(1U),",
        "a_look_is",
    ),
    Mutant("measures-on-a-head-at-work", "core/commands.c", "&& !board_measuring()", "&& false", "begins_to_measure"),
    Mutant(
        "odometer-not-given-back",
        "core/queries.c",
        "        board_measure(&(board_look_t){.looks = 0});",
        "",
        "odometer_counts_on",
    ),
    Mutant(
        "flash-not-taken-back-at-once",
        "rp2040/lamps.c",
        "    REGISTER(PIO_MEMORY(PIO0, TAKEN)) = JMP(LAMP_IDLE);\n",
        "",
        "taken_back",
    ),
    Mutant(
        "flag-to-look-lost",
        "rp2040/lamps.c",
        "looks ? FLAG_SET(LOOK) : FLAG_CLEAR(LOOK)",
        "FLAG_CLEAR(LOOK)",
        "edge_while",
    ),
    Mutant("edge-in-a-load-unsettled", "rp2040/lamps.c", "if (!sync_looks()) {", "if (false) {", "given_the_next"),
    Mutant(
        "hold-off-of-another-flash",
        "rp2040/lamps.c",
        "if (lit && (lamps.holdoff < flash->holdoff_ticks)) {",
        "if (false) {",
        "no_edge_is",
    ),
    Mutant(
        "duty-left-to-the-core",
        "rp2040/lamps.c",
        "(width * 1000U <= (uint64_t)LAMP_DUTY_MAX_PERMILLE * flash->holdoff_ticks) &&",
        "",
        "checks_nothing",
    ),
    Mutant(
        "duty-left-to-the-hold-off",
        "rp2040/lamps.c",
        "duty_allows(duty_of(flash->lamp), first_edge)",
        "(first_edge == first_edge)",
        "holds_nothing",
    ),
    Mutant(
        "odometer-at-edges-only",
        "rp2040/lamps.c",
        "    odometer_decode(transitions);\n",
        "    (void)transitions;\n",
        "there_and_back",
    ),
    Mutant(
        "odometer-ends",
        "rp2040/odometer.c",
        "DMA_CHAIN(DMA_ODOMETER_AGAIN)",
        "DMA_CHAIN(DMA_ODOMETER)",
        "two_thousand_million",
    ),
    Mutant(
        "odometer-loses-in-silence",
        "quadrature.h",
        "        self->lost += behind - QUADRATURE_HELD;\n",
        "",
        "stalled_processor_could",
    ),
    Mutant(
        "impossible-taken-for-nothing",
        "quadrature.h",
        "self->impossible += (step == 0) ? 1U : 0U;",
        "(void)step;",
        "lines_that_change_together",
    ),
    Mutant(
        "odometer-floods-the-line",
        "core/controller.c",
        "(missed != self->odometer_missed) && !self->odometer_hushed",
        "missed != self->odometer_missed",
        "lines_that_change_together",
    ),
    Mutant(
        "start-interrupted",
        "rp2040/time.c",
        "    interrupts_off();\n",
        "",
        "train_begins",
    ),
    Mutant(
        "boot-loader-without-usb",
        "core/commands.c",
        "const bool stranded = !board_bootloader_reachable();",
        "const bool stranded = false;",
        "only_with_a_usb_host",
    ),
    Mutant(
        "boot-loader-on-a-silent-bus",
        "rp2040/usbdata.c",
        "return usb_port.configured && !usb_port.suspended;",
        "return usb_port.configured;",
        "only_with_a_usb_host",
    ),
    Mutant(
        "update-while-armed",
        "core/commands.c",
        "} else if ((self->armed != 0U) || self->moving) {",
        "} else if (self->moving) {",
        "wrong_board_size_or_state",
    ),
    Mutant(
        "armed-while-an-update-is-written",
        "core/commands.c",
        "const bool busy = self->update.under_way && (command.outputs != 0U);",
        "const bool busy = false;",
        "under_way",
    ),
    Mutant(
        "update-for-another-board",
        "core/commands.c",
        "(command.board[i] == board_name()[i]) ? RANGE_OK : 2U",
        "RANGE_OK",
        "wrong_board_size_or_state",
    ),
    Mutant(
        "update-never-given-up",
        "core/update.c",
        "ticks_since(now, self->heard) > (int32_t)(UPDATE_SILENCE_MS * TICKS_PER_MS)",
        "ticks_since(now, self->heard) > INT32_MAX - 1",
        "under_way",
    ),
    Mutant(
        "update-with-a-wrong-crc",
        "core/update.c",
        "application_is_whole(staged, UPDATE_MAX_BYTES) && ",
        "",
        "damaged_or_foreign",
    ),
    Mutant(
        "update-of-another-boards-image",
        "core/update.c",
        "if (!whole || !belongs_here(staged)) {",
        "(void)belongs_here(staged);\n    if (!whole) {",
        "damaged_or_foreign",
    ),
    Mutant(
        "chunks-written-twice",
        "core/update.c",
        "if ((offset == self->next) && (self->next < self->size)) {",
        "if (self->next < self->size) {",
        "out_of_order",
    ),
    Mutant(
        "loader-over-what-usb-flashed",
        "rp2040/loader.c",
        "if ((!runs || old) && ",
        "if ((!runs || old || (RECORD.magic == RECORD_MAGIC)) && ",
        "overwritten",
    ),
    Mutant(
        "loader-takes-a-rotten-one",
        "rp2040/loader.c",
        "is_whole(STAGED) && ",
        "",
        "rots",
    ),
    Mutant(
        "loader-starts-nothing",
        "rp2040/loader.c",
        "    if (!startable) {",
        "    if (!startable && (RECORD.magic == 0U)) {",
        "without_a_whole",
    ),
    Mutant(
        "watchdog-bites-an-erase",
        "rp2040/staging.c",
        "    REGISTER(WATCHDOG_LOAD) = ERASE_MAX_MS * 2000U;\n",
        "",
        "slowest_erase",
    ),
    Mutant(
        "ticks-lost-in-an-erase",
        "rp2040/time.c",
        "    ticks += (elapsed - seen + 0x800000U) & ~0xFFFFFFU;\n",
        "    (void)(elapsed + seen);\n",
        "slowest_erase",
    ),
)


def judge(mutant: Mutant, scratch: Path) -> str:
    """'caught', or what went wrong with the experiment or, worst, 'SURVIVED'."""
    firmware = scratch / mutant.name
    shutil.copytree(ROOT / "firmware", firmware, ignore=shutil.ignore_patterns("build", "corpus"))
    source = firmware / mutant.file
    text = source.read_text()
    if text.count(mutant.right) == 0:
        return "STALE: the line it changes is gone"
    source.write_text(text.replace(mutant.right, mutant.wrong))
    build = subprocess.run(
        ["make", "--silent", "-C", str(firmware), "image", "GIT=mutant00", "BUILD=build"],
        capture_output=True,
        text=True,
    )
    if build.returncode != 0:
        return "NOT BUILT: " + build.stderr.splitlines()[0]
    run = subprocess.run(
        [sys.executable, "-m", "pytest", "-x", "-q", "--timeout", "120", "tests/emulator", "-k", mutant.tests],
        cwd=ROOT,
        env=os.environ | {"ANNULUS_IMAGE": str(firmware / "build/annulus.uf2")},
        capture_output=True,
        text=True,
    )
    return {0: "SURVIVED", 1: "caught"}.get(run.returncode, f"NO TEST RAN: {run.stdout.splitlines()[-1:]}")


def main(names: list[str]) -> int:
    chosen = [mutant for mutant in MUTANTS if not names or mutant.name in names]
    with tempfile.TemporaryDirectory() as scratch:
        verdicts = []
        for mutant in chosen:
            verdicts.append(judge(mutant, Path(scratch)))
            print(f"{mutant.name:32} {verdicts[-1]}", flush=True)
    caught = verdicts.count("caught")
    print(f"{caught} of {len(chosen)} mutants caught")
    return 0 if chosen and caught == len(chosen) else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
