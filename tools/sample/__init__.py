"""The sample recording that ships beside annulus as a package of its own, `annulus-sample`: `make sample`."""
