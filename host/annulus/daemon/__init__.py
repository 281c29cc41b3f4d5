"""Who ties methods to instruments: one head, run until told to stop."""
