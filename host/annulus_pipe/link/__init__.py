"""The line to a controller: bytes to messages and back, its clock, its being in service. No camera, no method."""
