"""A second light: drawn pipes photographed by Mitsuba 3, a path tracer, with what light does in a real one.

`camera` takes the pictures, `effects` names what may happen to light on its way: a skin that reflects (wet or dry),
light that goes on from wall to wall, a wall within which it wanders (`kernel`), a tube about the projector (`tube`),
dust on the slide (`slide`), a lens with field curvature, lateral colour, ghost and veil (`lens`). `shapes` is the pipe.
The pipe itself, its true surface and what a sensor makes of light are those of tools/bench/blind; how light goes is
shared with nothing: not with POV-Ray's text there, nor with the twin, nor with what is tested.

`python -m tools.bench metrology light` tells in mm what each effect does; `python -m tools.bench blind --light mitsuba`
draws the blind bench's pipes by it.

What is not as in a pipe: light that goes on from wall to wall is drawn smaller and smoothed, so a mirror's sharp
streaks are not there; light in the wall goes on along the pipe only, as in an even wall at the nominal radius, and
none is thrown back by the surface from inside; a tube reflects nothing and is in nobody's way; dirt is flat.
"""
