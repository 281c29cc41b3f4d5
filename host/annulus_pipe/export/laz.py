"""The cloud as LAZ: LAS 1.4, point format 7, metres, z up; what LAS has no place for in extra dimensions.

Written a part at a time, so that memory does not grow with the cloud. LAS gives coordinates as whole steps: of 1 um
where the cloud lies within 2 km of its origin, else of 10 um. There is no coordinate system to name, so none is.
"""

from datetime import datetime
from pathlib import Path

import numpy as np

from annulus_pipe.export.axes import Z_UP, in_space, z_up
from annulus_pipe.export.results import Results
from annulus_pipe.extras import need
from annulus_pipe.vocabulary import AnnulusError

CHUNK = 1 << 18  # points
TEXT_AREA = 3  # LAS's number of a record of free text
STEPS_MAX = 2.0e9  # of a coordinate, either way: a signed 32-bit number
EXTRA = (  # name, kind, description of at most 31 characters
    ("radius_mm", "float32", "from the pipe's axis, mm"),
    ("sigma_mm", "float32", "of the radius, k=1, mm"),
    ("frame", "int32", "of the recording"),
    ("ring", "uint8", "of the pattern, 0 innermost"),
    ("camera", "uint8", "that saw it"),
)


def write(results: Results, path: Path) -> None:
    laspy = need("laspy")
    need("lazrs")
    cloud = results.cloud.vertices
    file = results.folder / "cloud.ply"
    parts = [slice(at, at + CHUNK) for at in range(0, len(cloud), CHUNK)]
    reach = max(float(np.abs(in_space(np.asarray(cloud[part]), file)).max()) for part in parts)
    scale = 1e-6 if 1e-3 * reach < 1e-6 * STEPS_MAX else 1e-5
    if 1e-3 * reach >= scale * STEPS_MAX:
        raise AnnulusError(f"{file}: reaches {1e-3 * reach:.0f} m, expected at most 20 km")
    header = laspy.LasHeader(point_format=7, version="1.4")
    header.scales, header.offsets = np.full(3, scale), np.zeros(3)
    header.global_encoding.wkt = True  # LAS 1.4 asks it of this point format, with or without such a system
    header.system_identifier = "annulus"
    header.generating_software = results.made_by.encode("ascii", "replace").decode()[:31]
    try:
        header.creation_date = datetime.fromisoformat(results.created).date()
    except ValueError:
        header.creation_date = None
    extra = [one for one in EXTRA if one[0] != "camera" or "camera" in (cloud.dtype.names or ())]
    header.add_extra_dims([laspy.ExtraBytesParams(name, kind, about) for name, kind, about in extra])
    header.vlrs.append(laspy.VLR("LASF_Spec", TEXT_AREA, "what this is", _about(results)))
    with laspy.open(path, mode="w", header=header, do_compress=True) as out:
        for part in parts:
            records = np.asarray(cloud[part])
            points = laspy.ScaleAwarePointRecord.zeros(len(records), header=header)
            points.x, points.y, points.z = 1e-3 * z_up(in_space(records, file)).T
            for name in ("red", "green", "blue"):
                points[name] = records[name].astype(np.uint16) * 257  # 0..255 -> 0..65535
            points["return_number"] = points["number_of_returns"] = np.ones(len(records), np.uint8)
            for name, *_ in extra:
                points[name] = records[name.removesuffix("_mm")]
            out.write_points(points)


def _about(results: Results) -> bytes:
    lines = [
        f"metres; {Z_UP}; no coordinate reference system",
        f"scan: {results.source}",
        f"results: {results.created}",
    ]
    return "\n".join([*lines, *(f"{name}: {value}" for name, value in results.job.items())]).encode()[:60_000]
