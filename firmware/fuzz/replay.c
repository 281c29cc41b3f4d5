// Runs the fuzz target over files, for compilers without libFuzzer; and says which commands they reach. All of them is
// a promise: status 1 where one was never carried out.

#include <stdio.h>

#include "fuzz.h"

int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size);

static int missing(void)
{
    int count = 0;
    for (uint8_t id = 0; id < REPLY_BIT; id++) {
        if ((layout_of(id) != NULL) && (((watch_carried_out() >> id) & 1U) == 0U)) {
            printf("command 0x%02X is carried out by no input: make fuzz, then bring one to fuzz/corpus\n", id);
            count++;
        }
    }
    return count;
}

int main(const int count, char** const names)
{
    static uint8_t data[65536];
    for (int i = 1; i < count; i++) {
        FILE* const file = fopen(names[i], "rb");
        if (file == NULL) {
            printf("cannot open %s\n", names[i]);
            return 1;
        }
        const size_t size = fread(data, 1, sizeof data, file);
        fclose(file);
        LLVMFuzzerTestOneInput(data, size);
    }
    printf("%d inputs\n", count - 1);
    return (missing() == 0) ? 0 : 1;
}
