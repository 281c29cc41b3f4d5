"""The reference circuit around a controller: a SKiDL program, its netlist, its picture, and the label that belongs on a
head. `python -m tools.hardware OUT` writes them and checks the circuit's electrical rules.
"""
