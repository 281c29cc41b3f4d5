"""limits.toml: what somebody accepts of a pipe. docs/manual/limits.md has its form."""

from pathlib import Path

from annulus_pipe.untrusted import TOML_MAX, parse_toml, read_file
from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wall.conformity import Criteria


def load_limits(path: Path) -> Criteria:
    """The limits in a file. Raises AnnulusError naming file, section and key."""
    try:
        return Criteria.from_dict(parse_toml(read_file(path, TOML_MAX)))
    except OSError as error:
        raise AnnulusError(f"{path}: cannot be read ({error.strerror}). Expected a limits.toml.") from None
    except ValueError as error:
        raise AnnulusError(f"{path}: {error}.") from None
