"""The page from which a head is run, and the program that serves it. See README.md."""
