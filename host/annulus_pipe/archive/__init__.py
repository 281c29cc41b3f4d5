"""Surveys of many pipes over the years: the catalogue of them, and what two of one pipe say has grown."""
