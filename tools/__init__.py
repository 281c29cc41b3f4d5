"""What is made with the house but not shipped in it: benchmarks, the source's studies, the emulator, mutants."""
