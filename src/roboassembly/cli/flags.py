"""Flags and help texts of commands, made from the fields of their data classes.

The help of a flag is the docstring below its field; if the field's type has a `SharedHelp`, that comes first. A boolean
field that is true by default (`film: bool = True`) becomes the flag `--no-film`. Its docstring says what the command
does without the flag ("Render assembly.mp4."), so the help of the flag is the negation: "Do not render assembly.mp4."
"""

from __future__ import annotations

import ast
import dataclasses
import inspect
import textwrap
from functools import cache
from pathlib import Path
from typing import Annotated, Any, cast, get_args, get_origin, get_type_hints

import tyro
from tyro.constructors import ConstructorRegistry, StructConstructorSpec, StructFieldSpec, StructTypeInfo

CONFIG = (tyro.conf.FlagCreatePairsOff, tyro.conf.OmitSubcommandPrefixes, tyro.conf.DisallowNone)
"""Options of tyro: one flag per boolean, no prefixes, and no value `None` on the command line."""

PACKAGE = __name__.rpartition(".")[0]
"""Package whose data classes are commands."""


@dataclasses.dataclass(frozen=True)
class SharedHelp:
    """Help of an option that several commands have, as metadata of its type (`Annotated[str, SharedHelp("...")]`)."""

    text: str


def command_registry() -> ConstructorRegistry:
    """Return the tyro registry that makes flags from the fields of commands."""
    out = ConstructorRegistry()
    out.struct_rule(_command)
    return out


def _command(info: StructTypeInfo) -> StructConstructorSpec | None:
    """Return the flags of a command with their help texts; None for another type."""
    kind = cast("object", info.type)  # pyright: ignore[reportUnknownMemberType]
    if not (isinstance(kind, type) and dataclasses.is_dataclass(kind) and kind.__module__.startswith(PACKAGE)):
        return None
    hints = get_type_hints(kind, include_extras=True)
    return StructConstructorSpec(kind, tuple(_field(f, hints[f.name], kind) for f in dataclasses.fields(kind)))


def _field(field: dataclasses.Field[Any], hint: Any, kind: type) -> StructFieldSpec:
    default = tyro.MISSING if field.default is dataclasses.MISSING else field.default
    metadata = get_args(hint)[1:] if get_origin(hint) is Annotated else ()
    plain = get_args(hint)[0] if metadata else hint
    shared = [m.text for m in metadata if isinstance(m, SharedHelp)]
    text = " ".join([*shared, _texts(kind).get(field.name, "")]).strip()
    if default is True:
        text = f"Do not {text[:1].lower()}{text[1:]}"
    hide_default = default is None or isinstance(default, bool) or default == ()
    # Settings of the field itself come last and take precedence.
    common = tyro.conf.arg(metavar=_metavar(field, plain, metadata), help_behavior_hint="" if hide_default else None)
    annotated: Any = Annotated[(plain, common, *metadata)]
    return StructFieldSpec(field.name, annotated, default, text)


def _metavar(field: dataclasses.Field[Any], plain: Any, metadata: tuple[object, ...]) -> str | None:
    """Return the placeholder of a positional argument in the help; None for tyro's own."""
    if tyro.conf.Positional not in metadata or plain not in (str, Path, Path | None):
        return None
    return field.name.upper() if field.default is dataclasses.MISSING else f"[{field.name.upper()}]"


@cache
def _texts(kind: type) -> dict[str, str]:
    """Return the docstring of each field of a data class and of its bases, as one paragraph."""
    out: dict[str, str] = {}
    for owner in reversed(kind.__mro__):
        if not dataclasses.is_dataclass(owner):
            continue
        (body,) = ast.parse(textwrap.dedent(inspect.getsource(owner))).body
        assert isinstance(body, ast.ClassDef)
        for statement, below in zip(body.body, body.body[1:], strict=False):
            match statement, below:
                case ast.AnnAssign(target=ast.Name(id=name)), ast.Expr(value=ast.Constant(value=str(text))):
                    out[name] = " ".join(text.split())
                case _:
                    pass
    return out
