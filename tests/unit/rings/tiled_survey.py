"""A long pipe of a short one: the same survey end to end, so many times."""

from dataclasses import fields, replace

import numpy as np

from annulus_pipe.wall.survey import Survey


def tiled(survey: Survey, times: int) -> Survey:
    wall, detection = survey.wall, survey.detection
    rows = len(wall.z_mm)
    length = rows * wall.z_step_mm

    def longer(name: str, values: object) -> object:
        if not isinstance(values, np.ndarray) or values.shape[:1] != (rows,):
            return values
        return (
            wall.z_mm[0] + np.arange(rows * times) * wall.z_step_mm
            if name == "z_mm"
            else np.concatenate([values] * times)
        )

    def repeated(name: str, values: np.ndarray) -> np.ndarray:
        return np.concatenate([values + (k * length if name == "z_mm" else 0.0) for k in range(times)])

    label = detection.label
    shifted = [np.where(label > 0, label + k * len(detection.defects), 0).astype(label.dtype) for k in range(times)]
    defects = tuple(replace(one, z_mm=one.z_mm + k * length) for k in range(times) for one in detection.defects)
    kept = {f.name: getattr(survey.stations, f.name) for f in fields(survey.stations)}
    return replace(
        survey,
        wall=replace(wall, **{f.name: longer(f.name, getattr(wall, f.name)) for f in fields(wall) if f.init}),
        shadowed=np.concatenate([survey.shadowed] * times),
        texture=None if survey.texture is None else np.concatenate([survey.texture] * times),
        stations=replace(survey.stations, **{name: repeated(name, values) for name, values in kept.items()}),
        detection=replace(detection, label=np.concatenate(shifted), defects=defects),
    )
