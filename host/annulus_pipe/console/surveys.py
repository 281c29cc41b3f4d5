"""Routes of the Surveys tab: what lies in the folders that the console was given, and reconstructing it again."""

import asyncio
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from annulus_pipe.console.answers import Refusal, accepted, asked_for
from annulus_pipe.console.reconstructing import Reconstructing
from annulus_pipe.console.shelf import FILES, Entry, Shelf
from annulus_pipe.vocabulary import AnnulusError

if TYPE_CHECKING:
    from collections.abc import Coroutine

    from starlette.requests import Request
    from starlette.responses import Response

SHOWN = ("report.html", "unwrapped.png", "texture.png", "height.png", "sigma.png")  # others are saved


class TopicHub(Protocol):
    def tell(self, topic: str, body: Any) -> None: ...


class Host(Protocol):
    """What is needed of the program."""

    @property
    def hub(self) -> TopicHub: ...

    @property
    def surveys(self) -> Sequence[Path]: ...

    def spawn(self, work: "Coroutine[Any, Any, None]") -> Any: ...


def routes(program: Host, command: Sequence[str] | None = None) -> list[Any]:
    """command : what reconstructs, in place of annulus itself."""
    from starlette.responses import FileResponse
    from starlette.routing import Route

    shelf = Shelf(program.surveys)
    looking = asyncio.Lock()
    queue: list[Reconstructing] = []  # made within the loop that it runs in

    def reconstructing() -> Reconstructing:
        if not queue:
            queue.append(Reconstructing(lambda jobs: program.hub.tell("reconstruct", {"jobs": jobs}), command))
            program.spawn(queue[0].run())
        return queue[0]

    async def entry(number: object, kinds: Sequence[str]) -> Entry:
        """On the list. Raises Refusal."""
        found = shelf.listing.by_id.get(number) if isinstance(number, str) else None
        if found is None:
            async with looking:
                found = (await asyncio.to_thread(shelf.look)).by_id.get(str(number))
        if found is None or found.kind not in kinds:
            raise Refusal(404, f"no such {' or '.join(kinds)} is on the list")
        return found

    async def listed(request: "Request") -> "Response":
        async with looking:
            listing = await asyncio.to_thread(shelf.look)
        jobs = queue[0].jobs() if queue else []
        if request.query_params.get("known") == listing.stamp:  # a page looks now and then, a thousand are 600 kB
            return accepted(same=True, stamp=listing.stamp, jobs=jobs)
        return accepted(
            stamp=listing.stamp,
            folders=[str(folder) for folder in shelf.folders],
            entries=[one.to_dict() for one in listing.entries],
            calibrations=[one.to_dict() for one in listing.calibrations],
            left_out=listing.left_out,
            waiting=listing.waiting,
            jobs=jobs,
        )

    async def reconstruct(request: "Request") -> "Response":
        asked: Mapping[str, Any] = await asked_for(request)
        scan = await entry(asked.get("scan"), ("recording", "scan"))
        if scan.details.get("state") == "open":
            raise Refusal(409, f"{scan.path.name} is being recorded, expected one that has ended")
        with_calibration = asked.get("calibration")
        calibration = None
        if with_calibration is not None:
            calibration = (await entry(with_calibration, ("calibration",))).path
        elif scan.kind == "scan" and scan.details.get("calibrated"):
            calibration = scan.path / "calibration.json"
        elif not scan.details.get("calibrated"):
            raise Refusal(409, f"{scan.path.name} carries no calibration, expected one to be chosen")
        return accepted(id=reconstructing().ask(scan.path, calibration).id)

    async def cancel(request: "Request") -> "Response":
        asked = await asked_for(request)
        if not queue:
            raise AnnulusError("no reconstruction is under way")
        queue[0].cancel(str(asked.get("id")))
        return accepted()

    async def file(request: "Request") -> "Response":
        result = await entry(request.path_params["id"], ("result",))
        name = request.path_params["name"]
        path = result.path / name if name in FILES else None
        if path is None or path.is_symlink() or not path.is_file():
            raise Refusal(404, f"no such file is of {result.path.name}")
        headers = {"Cache-Control": "no-store"}
        if name not in SHOWN:
            headers["Content-Disposition"] = f'attachment; filename="{name}"'
        return FileResponse(path, media_type=FILES[name], headers=headers)

    return [
        Route("/api/surveys", listed),
        Route("/api/surveys/reconstruct", reconstruct, methods=["POST"]),
        Route("/api/surveys/cancel", cancel, methods=["POST"]),
        Route("/api/surveys/file/{id:str}/{name:str}", file),
    ]
