"""Fuzzers of every reader: `python -m tools.bench fuzz --target TARGET --minutes 10 --seed 1`.

The law: whatever comes, a result or AnnulusError with one printable line, within 5 s of the processor and 2 GiB; of a
recording's pixels: what was written, or the damage is told. A case follows from seed, target and number alone, so a
finding is made again by `--case NUMBER`. Each finding keeps its input in the folder that is printed, and becomes a
`tests/regression`.
"""
