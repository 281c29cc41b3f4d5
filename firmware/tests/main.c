// Runs every test; status 1 when a promise is broken.

#include "check.h"

#include <stdio.h>

#define SHOWN_PER_TEST 5

static int failures;
static int shown;  // of the running test
static int tests;

void check_equal(const char* const file, const int line, const char* const what, const int64_t got,
                 const int64_t expected)
{
    if (got == expected) {
        return;
    }
    failures++;
    if (++shown <= SHOWN_PER_TEST) {
        printf("%s:%d: %s is %lld, expected %lld\n", file, line, what, (long long)got, (long long)expected);
    }
}

void check_run(const char* const promise, void (*const test)(void))
{
    const int before = failures;
    tests++;
    shown = 0;
    test();
    if (failures != before) {
        printf("BROKEN %s\n", promise);
    }
}

int main(void)
{
    setvbuf(stdout, NULL, _IOLBF, 0);  // what was said survives a sanitizer's abort
    link_tests();
    lines_tests();
    queries_tests();
    configuration_tests();
    polarity_tests();
    camera_trigger_tests();
    slides_tests();
    ranges_tests();
    sequencer_tests();
    lamps_tests();
    preamble_tests();
    safety_tests();
    interlock_tests();
    bursts_tests();
    turntable_tests();
    measure_tests();
    board_tests();
    odometer_tests();
    update_tests();
    printf("%d tests, %d failures\n", tests, failures);
    return (failures == 0) ? 0 : 1;
}
