"""Under `make test` a skip is a failure: all that tests need is part of set-up, and what did not run proves nothing."""

import os
from collections.abc import Generator

import pytest

ALLOWED = ("../shared", "too busy")  # scenes that only the authors have; a machine that cannot emulate in real time


def _strict(report: pytest.TestReport | pytest.CollectReport) -> None:
    why = report.longrepr[2] if isinstance(report.longrepr, tuple) else str(report.longrepr)
    if "ANNULUS_NO_SKIPS" in os.environ and report.skipped and not any(word in why for word in ALLOWED):
        report.outcome, report.longrepr = "failed", f"make test takes no skips: {why}"


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport() -> Generator[None, pytest.TestReport, pytest.TestReport]:
    report = yield
    _strict(report)
    return report


@pytest.hookimpl(wrapper=True)
def pytest_make_collect_report() -> Generator[None, pytest.CollectReport, pytest.CollectReport]:
    report = yield
    _strict(report)
    return report
