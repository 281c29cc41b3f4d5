"""A message's fields as the bytes of its payload, and back: one codec over the table of fields that a message class is.

A class of messages.py states its fields and, with `wire`, id, schema byte and a struct code for each field, in order.
"""

import struct
from collections.abc import Callable
from dataclasses import dataclass, fields
from enum import Enum
from functools import cache
from typing import ClassVar, Self, TypeVar, dataclass_transform

from annulus_pipe.vocabulary import AnnulusError


@dataclass(frozen=True, slots=True)
class Message:
    """What every message has. ID and SCHEMA_BYTE enter the frame; LENGTH is the payload's, bytes; SINCE the level."""

    NAME: ClassVar[str]
    ID: ClassVar[int]
    SINCE: ClassVar[int]
    SCHEMA_BYTE: ClassVar[int]
    LAYOUT: ClassVar[struct.Struct]
    LENGTH: ClassVar[int]
    FIELDS: ClassVar[tuple[str, ...]]
    _ENUMS: ClassVar[tuple[tuple[int, Callable[[int], Enum]], ...]]  # places of enumerations and flags, their members
    _BYTES: ClassVar[tuple[tuple[int, int], ...]]  # places of bytes, how many fit

    def pack(self) -> bytes:
        """The payload, LENGTH bytes; AnnulusError for a value that does not fit its field."""
        values = [getattr(self, name) for name in self.FIELDS]
        for at, size in self._BYTES:
            if len(values[at]) > size:
                raise AnnulusError(f"{self.NAME}.{self.FIELDS[at]}: {len(values[at])} bytes where {size} fit")
        try:
            return self.LAYOUT.pack(*values)
        except struct.error as error:
            raise AnnulusError(f"{self.NAME}: a value does not fit its field on the wire: {error}") from None

    @classmethod
    def unpack(cls, payload: bytes) -> Self:
        """The message in a payload; ValueError for another length than LENGTH or a value that an enumeration lacks."""
        if len(payload) != cls.LENGTH:
            raise ValueError(f"payload of {len(payload)} bytes where {cls.LENGTH} were expected")
        values = list(cls.LAYOUT.unpack(payload))
        for at, member in cls._ENUMS:
            values[at] = member(values[at])
        return cls(*values)


M = TypeVar("M", bound=Message)


@dataclass_transform(frozen_default=True)
def wire(name: str, number: int, schema_byte: int, codes: str, since: int = 1) -> Callable[[type[M]], type[M]]:
    """Makes a frozen dataclass of annotated fields, and a message of that. `codes`: of `struct`, one a field."""

    def message(table: type[M]) -> type[M]:
        cls = dataclass(frozen=True, slots=True)(table)
        coded = list(zip(fields(cls), codes.split(), strict=True))
        cls.NAME, cls.ID, cls.SCHEMA_BYTE, cls.SINCE = name, number, schema_byte, since
        cls.LAYOUT = struct.Struct("<" + "".join(code for _, code in coded))
        cls.LENGTH = cls.LAYOUT.size
        cls.FIELDS = tuple(field.name for field, _ in coded)
        cls._ENUMS = tuple(
            (at, cache(field.type))  # a cache: half the time that an enumeration takes to find its member
            for at, (field, _) in enumerate(coded)
            if isinstance(field.type, type) and issubclass(field.type, Enum)
        )
        cls._BYTES = tuple((at, int(code[:-1])) for at, (_, code) in enumerate(coded) if code.endswith("s"))
        return cls

    return message
