// Runs the fuzz target over files, for compilers without libFuzzer.

#include <stddef.h>
#include <stdint.h>
#include <stdio.h>

int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size);

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
    return (count > 1) ? 0 : 1;
}
