"""scan.mcap, a recording of a simulated pipe with four known defects, and truth.json, where they are. No code."""
