"""Files that outlive the process: where they lie, here or in a store; written whole, read with suspicion.

Their forms, and who writes which: README.md. Knows no scan and no recording.
"""
