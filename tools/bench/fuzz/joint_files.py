"""Files of a joint, made wrong: strengths, results, light through dogbones, sweeps, a scan's log."""

from collections.abc import Callable
from pathlib import Path
from random import Random

from annulus_pipe.wings.joints.raster_log import RasterLog
from annulus_pipe.wings.joints.strength_file import read_results, read_strengths, read_transmission
from annulus_pipe.wings.joints.sweep_file import read_places, read_sweep
from tools.bench.fuzz.mutate import of_bytes, of_rows

LOG = '# annulus near-field scan 1\n# {"angles": 3, "boot": 1}\ni,j,amplitude_mv\n'
FILES: dict[str, tuple[str, Callable[[Path], object]]] = {
    "strength.csv": ("angle_deg,energy_j\n" + "".join(f"{45 * i},{20 + i}\n" for i in range(8)), read_strengths),
    "results.csv": ("joint,angle_deg,result\n" + "".join(f"a,{45 * i},good\n" for i in range(8)), read_results),
    "ots.csv": ("z_mm,dogbone_0,dogbone_45\n" + "".join(f"{i},{8 + i},7.5\n" for i in range(20)), read_transmission),
    "a.s1p": ("# GHz S DB R 50\n" + "".join(f"{2 + 0.01 * i} -3 {i}\n" for i in range(20)), read_sweep),
    "a.s2p": ("# MHz S RI R 50\n" + "".join(f"{4 + i} .1 .2 .3 .4 .5 .6 .7 .8\n" for i in range(20)), read_sweep),
    "sweep.csv": ("frequency_hz,magnitude_db\n" + "".join(f"{1e9 + i},-3\n" for i in range(20)), read_sweep),
    "points.csv": ("point,file,z_mm\nair,a.s1p,\n" + "".join(f"at,{i}.s1p,{i}\n" for i in range(20)), read_places),
    "log.csv": (LOG + "".join(f"0,{i},{300 + i}\n" for i in range(20)), lambda path: RasterLog.resumed(path).close()),
}


def joint_case(rng: Random) -> bytes:
    name = rng.choice(tuple(FILES))
    table = FILES[name][0]
    made = of_bytes(rng, table.encode()) if rng.random() < 0.5 else of_rows(rng, table).encode("utf-8", "surrogatepass")
    return name.encode() + b"\0" + made


def joint_read(data: bytes, folder: Path) -> None:
    name, _, content = data.partition(b"\0")
    path = folder / name.decode()
    path.write_bytes(content)
    FILES[path.name][1](path)
