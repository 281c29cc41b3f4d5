"""Benchmarks: numbers of this project beside the source's, beside theory, and beside what was asked.

`python -m tools.bench TABLE [TOPIC ..]`. A table is a folder that names its topics; a topic is a module in it with
`rows()`, and a `NOTE` if its rows need one. A topic that breaks costs its own rows and no others.
"""
