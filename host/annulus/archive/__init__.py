"""Surveys of many pipes over the years: the catalogue of them, and what two of one pipe say has grown."""

from annulus.archive.comparison import Comparison as Comparison
from annulus.archive.comparison import compare as compare
