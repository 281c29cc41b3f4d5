"""Numbers without a subject: array types, compiled loops, robust statistics. Knows nothing of pipes."""
