"""Pipes that nobody has seen: drawn from a seed, photographed by POV-Ray, surveyed, and the survey held to its word.

`python -m tools.bench blind --seed N [--pipes K | --pipes SEED,SEED] [--light mitsuba] [--jobs 2] [--keep FOLDER]
[--score-only]`

A pipe's own seed is N * 1000 + i. It draws the pipe (`draw`), whose wall is one analytic radius r(clock, chainage)
about a centre line (`surface`); that wall is meshed (`mesh`) and lit by a slide projector in POV-Ray (`pov`), the light
is taken by a sensor (`sensor`), and what lies in the folder then is a scan like any other (`scan`). Its results are
read (`results`), held against r (`score`, `cloud`), and summed up (`table`). No line of optics or geometry is shared
with the twin or with what is tested.

`--of joints|crossbore|calibration|stereo|fringe` draws for the other methods: see `others`.

Even seeds are for setting constants by; the table is made on odd ones, once: a seed that was looked at is blind no
more. Needs POV-Ray 3.7 (`apt-get install povray`). With `--light mitsuba` the same pipes are photographed by another
program, with what light does in a real pipe (tools/light), by a sensor of 512 pixels a row, without
every third frame of the longer scans.

What is not as in a pipe, by POV-Ray: light goes straight from the slide to the wall and from the wall to the lens, none
from wall to wall or within the wall. By either: lenses have no distortion; nothing moves while a lamp is lit; the head
does not roll; water is muddy. How far a survey's axis is off is no error of the cloud, which is held about that axis.
"""
