"""How fast the frame's way is, how fast the twin draws, and what the shipped image's pins do under load."""

from pathlib import Path

from tools.bench.table import Table

TABLE = Table(
    __name__,
    "Speed",
    {
        "rings": "One projector frame, one core",
        "twin": "The twin's renderer, one thread",
        "latency": "From a frame in hand to its label at a viewer, while recording",
        "pictures": "What viewers see of a frame, in the publisher's process, one core",
        "codecs": "How a recording keeps its pictures",
        "memory": "What each process of a scan keeps for good",
        "kills": "Every process of a scan killed and stopped in turn, with three others spinning",
        "console": "The console: what it costs, how soon a viewer has a picture, and a page shows it",
        "console_hours": "What console and page keep of a long scan",
        "console_faults": "What console, network and viewers can do to a scan",
        "catalogue": "A catalogue of four million stations, asked, added to, listed",
        "long_scan": "A scan of 20 GB on one machine: memory of all its processes, time",
        "storage": "Recordings in an object store, and their index: requests, bytes, time",
        "endurance": "A crowd, death loops, no memory, a day of cycles, a second daemon, lamps tuned meanwhile",
        "soak": "Labels and places under faults, in virtual time",
        "cluster": "A cluster: what a task costs, and a scan in ranges against the serial run",
        "emulator": "The shipped image over 200 000 edges, on its pins",
    },
    Path(__file__).parent,
)
