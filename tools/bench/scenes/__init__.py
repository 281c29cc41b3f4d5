"""Ray-traced scans with truth: `python -m tools.bench scenes [FOLDER] [--only s01a-butt ..] [--keep RESULTS]`.

Every scene of FOLDER (what is shared beside the checkout, if not given) is reconstructed and scored by the folder's own
`score_real.py`; one row a scene, one line for each thing in it, targets stated. Ends with status 1 if one is missed.
`--blind SEED` draws the twin's five pipes of several pieces instead; a seed that was looked at is blind no more.
"""
