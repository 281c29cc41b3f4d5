"""`annulus tune`: where a flash lights all rows alike, measured on the running head."""

import contextlib
import json
from typing import TYPE_CHECKING, Annotated, Any

import typer

from annulus_pipe.cli.running import At, Config, DaemonKey, KeyFile, configured, named_by
from annulus_pipe.cli.show import Bars, Json, progress, tell
from annulus_pipe.vocabulary import AnnulusError

if TYPE_CHECKING:
    from annulus_pipe.daemon.tuning import Tuned

EXAMPLE = "Example: annulus tune --config head.toml --lamp led"
COLUMNS = 40


def tune(
    config: Config = None,
    daemon: At = None,
    lamp: Annotated[str, typer.Option(help="projector, led or both.")] = "both",
    camera: Annotated[int, typer.Option(min=0, max=7, help="The camera that looks.")] = 0,
    apply: Annotated[bool, typer.Option("--apply", help="Put what is found in force on the running head.")] = False,
    json_: Json = False,
    key_file: KeyFile = None,
    daemon_key: DaemonKey = None,
) -> None:
    """Find where a flash lights all rows alike, on a running head at rest. Lamps flash meanwhile; nobody else changes
    them, for this program commands.
    """
    import secrets

    from annulus_pipe.daemon.command import Operator
    from annulus_pipe.daemon.control import ControlClient
    from annulus_pipe.daemon.tuning import LAMPS
    from annulus_pipe.daemon.tuning import tune as tuned

    if (daemon is None) == (config is None):
        raise AnnulusError("expected one of --config head.toml and --daemon PUBLISH,CONTROL")
    if lamp not in {*LAMPS, "both"}:
        raise AnnulusError(f"--lamp {lamp}: expected projector, led or both")
    where = configured(config, key_file) if config is not None else named_by(daemon or "", key_file, daemon_key)
    found: list[Tuned] = []
    applied, problem = False, None
    me = Operator(secrets.token_hex(16), "annulus tune")
    with ControlClient(where.control, where.control_keys, me) as client, progress(Bars.BAR) as report:
        client.command()
        try:
            found.extend(  # one by one: when the second cannot be found, the first is shown
                tuned(client, where.publish, one, keys=where.publish_keys, camera=camera, progress=report)
                for one in (LAMPS if lamp == "both" else (lamp,))
            )
            if apply:
                client.lamps(commit=True, trial=False, **_proposed(found))
                applied = True
        except AnnulusError as error:  # what is found by then is shown all the same
            problem = error
        finally:
            with contextlib.suppress(AnnulusError):  # it lapses
                client.release()
    _show(found, applied, json_)
    if problem is not None:
        raise problem


def _proposed(found: "list[Tuned]") -> dict[str, Any]:
    return {key: value for one in found for key, value in one.proposed.items()}


def _show(found: "list[Tuned]", applied: bool, json_: bool) -> None:
    proposed = _proposed(found)
    if not found:
        return
    if json_:
        print(
            json.dumps(
                {"lamps": proposed, "applied": applied, "found": {one.lamp: one.proposal.to_dict() for one in found}}
            )
        )
        return
    for one in found:
        print("\n".join([*one.remarks, "", *picture(one), ""]))
    print("\n".join(["[lamps]", *(f"{key} = {value:g}" for key, value in proposed.items())]))
    if applied:
        tell("in force on the running head until it restarts: head.toml keeps them")


def picture(found: "Tuned") -> list[str]:
    """Light of all rows, and of the band that got the least of its own, against delay."""
    proposal = found.proposal
    lit = proposal.full > 0.1 * proposal.full.max()
    lines = ["  delay us   light  least band"]
    for one in sorted(found.readings, key=lambda reading: reading.delay_us):
        least = float(((one.light - proposal.black)[lit] / proposal.full[lit]).min())
        bar = "#" * round(COLUMNS * min(max(least, 0.0), 1.0))
        lines.append(f"{one.delay_us:>10.0f} {one.light.mean():>7.1f} {100 * least:>8.0f} %  {bar}")
    return lines
