"""The manual: what of it is generated from code, and what builds it (`make docs`)."""
