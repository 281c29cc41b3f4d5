"""A value and who vouches for it: canonical JSON under an Ed25519 signature (RFC 8032).

What is signed is the JSON of the content with sorted names and no spaces, so that a file may be laid out anew, and not
a digit of it changed.
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from annulus_pipe.untrusted import mapping, read_file, text
from annulus_pipe.vocabulary import AnnulusError

KEY_MAX = 1 << 14  # bytes of a key's file
ALGORITHM = "Ed25519"
SHOWN_HEX = 16  # digits of a public key that people compare: 64 bits


@dataclass(frozen=True, slots=True)
class Signature:
    """public_key, value : hex, of 32 and 64 bytes."""

    public_key: str
    value: str

    @property
    def fingerprint(self) -> str:
        """What people compare: the first digits of the public key."""
        return self.public_key[:SHOWN_HEX]

    def to_dict(self) -> dict[str, str]:
        return {"algorithm": ALGORITHM, "public_key": self.public_key, "value": self.value}

    @classmethod
    def from_dict(cls, data: object) -> "Signature":
        """Raises ValueError naming the key."""
        section = mapping(data, "signature")
        if section.get("algorithm") != ALGORITHM:
            raise ValueError(f"signature.algorithm: expected {ALGORITHM}")
        return cls(_hex(section, "public_key", 32), _hex(section, "value", 64))

    def holds(self, content: Mapping[str, Any]) -> bool:
        """Whether the content is what was signed. Who owns the key, it does not say."""
        from cryptography.exceptions import InvalidSignature
        from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey

        try:
            key = Ed25519PublicKey.from_public_bytes(bytes.fromhex(self.public_key))
            key.verify(bytes.fromhex(self.value), canonical(content))
        except (InvalidSignature, ValueError):
            return False
        return True


def canonical(content: Mapping[str, Any]) -> bytes:
    return json.dumps(content, sort_keys=True, separators=(",", ":"), allow_nan=False).encode()


def sign(content: Mapping[str, Any], key: Path) -> Signature:
    """key : a file of `make_key`. Raises AnnulusError, one line, where it is none."""
    from cryptography.hazmat.primitives import serialization
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

    data = _read(key)
    try:
        private = serialization.load_pem_private_key(data, password=None)
    except (ValueError, TypeError):
        private = None
    if not isinstance(private, Ed25519PrivateKey):
        raise AnnulusError(f"{key}: no private key. Expected a file made by `annulus certify key`.")
    public = private.public_key().public_bytes(serialization.Encoding.Raw, serialization.PublicFormat.Raw)
    return Signature(public.hex(), private.sign(canonical(content)).hex())


def make_key() -> tuple[bytes, bytes]:
    """A new private key and its public one, both as PEM."""
    from cryptography.hazmat.primitives import serialization
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

    private = Ed25519PrivateKey.generate()
    pem = serialization.Encoding.PEM
    return (
        private.private_bytes(pem, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()),
        private.public_key().public_bytes(pem, serialization.PublicFormat.SubjectPublicKeyInfo),
    )


def public_key(path: Path) -> str:
    """Hex of a public key's file. Raises AnnulusError, one line, where it is none."""
    from cryptography.hazmat.primitives import serialization
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey

    try:
        key = serialization.load_pem_public_key(_read(path))
    except ValueError:
        key = None
    if not isinstance(key, Ed25519PublicKey):
        raise AnnulusError(f"{path}: no public key. Expected the .pub file of `annulus certify key`.")
    return key.public_bytes(serialization.Encoding.Raw, serialization.PublicFormat.Raw).hex()


def _read(path: Path) -> bytes:
    try:
        return read_file(path, KEY_MAX)
    except OSError as error:
        raise AnnulusError(f"{path}: cannot be read ({error.strerror}). Expected a key's file.") from None
    except ValueError as error:
        raise AnnulusError(f"{path}: {error}. Expected a key's file.") from None


def _hex(section: Mapping[str, Any], key: str, size: int) -> str:
    value = text(section.get(key), f"signature.{key}", 2 * size)
    if len(value) != 2 * size or any(c not in "0123456789abcdef" for c in value):
        raise ValueError(f"signature.{key}: expected {2 * size} hexadecimal digits")
    return value
