// Which of the libraries this processor can run, of which the one for any processor is asked; and what they were built
// from.

#include "native.h"

DOOR int64_t processor_level(void)
{
#if defined(__x86_64__)
    __builtin_cpu_init();
    return __builtin_cpu_supports("x86-64-v4") ? 4 : __builtin_cpu_supports("x86-64-v3") ? 3 : 2;
#else
    return 0;
#endif
}

DOOR const char* library_sources(void)
{
    return SOURCES;
}
