// The least a unit test needs: named promises, numbers compared, failures counted.

#ifndef ANNULUS_CHECK_H
#define ANNULUS_CHECK_H

#include <stdint.h>

void check_equal(const char* file, int line, const char* what, int64_t got, int64_t expected);
void check_run(const char* promise, void (*test)(void));

#define EXPECT_EQ(got, expected) check_equal(__FILE__, __LINE__, #got, (int64_t)(got), (int64_t)(expected))
#define EXPECT(condition) check_equal(__FILE__, __LINE__, #condition, (condition) ? 1 : 0, 1)
#define RUN(test) check_run(#test, test)

void link_tests(void);
void lines_tests(void);
void queries_tests(void);
void configuration_tests(void);
void polarity_tests(void);
void camera_trigger_tests(void);
void slides_tests(void);
void ranges_tests(void);
void sequencer_tests(void);
void lamps_tests(void);
void preamble_tests(void);
void safety_tests(void);
void interlock_tests(void);
void bursts_tests(void);
void turntable_tests(void);
void measure_tests(void);
void board_tests(void);
void odometer_tests(void);
void update_tests(void);

#endif
