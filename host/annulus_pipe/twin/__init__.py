"""The simulated head: the controller's real code, a camera that sees what its lamps lit, and a pipe to look at.

It closes the loop honestly. The firmware's gates are integrated over each row's exposure (`image_sensor`, where light
and time meet, without a clock), and what the camera would see of that is rendered (`rays`, `walls`, `lights`,
`worlds`). `head` runs all of it in real time in a process of its own, `soak` in virtual time; `acoustic` is the
thermoacoustic rig. The host cannot tell, and no room of the host imports this one but demonstrations and the command
line. What differs from reality is listed in README.md.
"""
