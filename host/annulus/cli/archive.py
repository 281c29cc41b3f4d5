"""`annulus archive`: surveys of many pipes over the years."""

from annulus.cli.compare import EXAMPLE as COMPARE_EXAMPLE
from annulus.cli.compare import compare
from annulus.cli.show import group

app = group("Surveys of many pipes over the years: what was scanned when, and what has grown.")
app.command(epilog=COMPARE_EXAMPLE)(compare)
