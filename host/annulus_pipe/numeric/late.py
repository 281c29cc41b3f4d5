"""Parts of scipy, each imported when something of it is first asked for.

They are half of what a worker or a refusal would otherwise begin with, and neither asks for any.

>>> from annulus_pipe.numeric.late import ndimage
>>> ndimage.label(cells)
"""

from importlib import import_module
from typing import Any


class _Late:
    def __init__(self, name: str) -> None:
        self._name = name

    def __getattr__(self, attribute: str) -> Any:
        if attribute.startswith("__"):  # what copying and pickling ask of any object
            raise AttributeError(attribute)
        found = getattr(import_module(self._name), attribute)
        setattr(self, attribute, found)  # from now on it costs what any attribute does
        return found


fft: Any = _Late("scipy.fft")
interpolate: Any = _Late("scipy.interpolate")
linalg: Any = _Late("scipy.linalg")
ndimage: Any = _Late("scipy.ndimage")
optimize: Any = _Late("scipy.optimize")
signal: Any = _Late("scipy.signal")
sparse: Any = _Late("scipy.sparse")
spatial: Any = _Late("scipy.spatial")
special: Any = _Late("scipy.special")
stats: Any = _Late("scipy.stats")
transform: Any = _Late("scipy.spatial.transform")
