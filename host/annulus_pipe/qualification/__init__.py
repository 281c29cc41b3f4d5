"""What a head is worth, by methods that others wrote: its accuracy (ASTM E691, GUM), what it detects (ASTM E2862,
E3023), and whether what was claimed of it holds (API 1163). Numbers in, values out; it opens no scan and no results."""
