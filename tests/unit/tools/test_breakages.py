"""A fault is drawn from a seed, is one, and stands where code is."""

import ast

from tools.breakages import drawn

SOURCE = {
    "host/annulus/a.py": '''"""Not 1 < 2."""
LIMIT: "1 + 1" = 3

def f(x: int = 4, y: "a < b" = 2) -> int:
    """Nor 3 * 4."""
    if not x and x + 1 < LIMIT * 2.5:
        return x if y else 7
    return True
'''
}


def test_one_seed_has_the_same_faults_and_another_has_others() -> None:
    assert drawn(SOURCE, 1, 5) == drawn(SOURCE, 1, 5)
    assert drawn(SOURCE, 1, 5) != drawn(SOURCE, 2, 5)


def test_every_fault_compiles_differs_and_stands_in_a_functions_body() -> None:
    faults = drawn(SOURCE, 3, 100)
    assert len(faults) == 10
    for fault in faults:
        assert ast.dump(ast.parse(fault.source)) != ast.dump(ast.parse(SOURCE[fault.file]))
        assert fault.line in (6, 7, 8)
        assert fault.room == "a"
