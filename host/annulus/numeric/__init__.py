"""Numbers without a subject: array types, compiled loops. Knows nothing of pipes."""
