"""A survey as files and pages: cloud, mesh, maps, tables, a summary for programs and a report to hand over.

Computes nothing and knows no method: what it writes is an attribute of `wall.Survey`, or stands in the `ScanAccount`
beside it.
"""

from annulus_pipe.report.account import ScanAccount
from annulus_pipe.report.pdf import Paper, check_pdf
from annulus_pipe.report.results import FILES, prepare_folder, write
from annulus_pipe.report.whole import keep_windows, write_whole, write_window

__all__ = [
    "FILES",
    "Paper",
    "ScanAccount",
    "check_pdf",
    "keep_windows",
    "prepare_folder",
    "write",
    "write_whole",
    "write_window",
]
