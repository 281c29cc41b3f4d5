"""Each witness earns its keep: with all of them nothing is wrong, without it alone labels are wrong or gone."""

import pytest

from annulus_pipe.capture.proof import Witness
from annulus_pipe.twin.witnesses import CASES, Case, compared


def test_every_witness_has_a_case() -> None:
    assert {case.witness for case in CASES} == set(Witness)


@pytest.mark.deep(but=1)
@pytest.mark.parametrize("case", CASES, ids=[str(case.witness) for case in CASES])
def test_labels_are_wrong_or_gone_where_the_witness_is_silent(case: Case) -> None:
    row = compared(case)
    assert row["wrong"] == 0
    assert row["wrong_without"] > 0 or row["unknown_without"] > 10 * row["unknown"]
