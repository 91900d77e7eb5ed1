"""How the fields of a command become flags with help that reads right.

A field's help is the text below it, as one paragraph. A boolean field that is true by default, `film: bool = True`, has
the flag `--no-film`; its text says what the command does without the flag ("Render assembly.mp4."), so the flag's help
is the opposite: "Do not render assembly.mp4."
"""

from __future__ import annotations

import ast
import dataclasses
import inspect
import textwrap
from functools import cache
from pathlib import Path
from typing import Annotated, Any, get_args, get_origin, get_type_hints

import tyro
from tyro.constructors import ConstructorRegistry, StructConstructorSpec, StructFieldSpec, StructTypeInfo

CONFIG = (tyro.conf.FlagCreatePairsOff, tyro.conf.OmitSubcommandPrefixes, tyro.conf.DisallowNone)
"""One flag for a boolean, no prefixes, and no value `None` that could be typed."""

_PACKAGE = __name__.rpartition(".")[0]


def registry() -> ConstructorRegistry:
    """What makes flags of the fields of commands."""
    out = ConstructorRegistry()
    out.struct_rule(_command)
    return out


def _command(info: StructTypeInfo) -> StructConstructorSpec | None:
    """The fields of a command, each with its help."""
    kind = info.type
    if not (dataclasses.is_dataclass(kind) and isinstance(kind, type) and kind.__module__.startswith(_PACKAGE)):
        return None
    hints = get_type_hints(kind, include_extras=True)
    return StructConstructorSpec(kind, tuple(_field(f, hints[f.name], kind) for f in dataclasses.fields(kind)))


def _field(field: dataclasses.Field[Any], hint: Any, kind: type) -> StructFieldSpec:
    default = tyro.MISSING if field.default is dataclasses.MISSING else field.default
    text = _texts(kind).get(field.name, "")
    if default is True:
        text = f"Do not {text[:1].lower()}{text[1:]}"
    metadata = get_args(hint)[1:] if get_origin(hint) is Annotated else ()
    plain = get_args(hint)[0] if metadata else hint
    unsaid = default is None or isinstance(default, bool) or default == ()
    # What a field says of itself comes last, and counts.
    usual = tyro.conf.arg(metavar=_metavar(field, plain, metadata), help_behavior_hint="" if unsaid else None)
    marked: Any = Annotated[(plain, usual, *metadata)]
    return StructFieldSpec(field.name, marked, default, text)


def _metavar(field: dataclasses.Field[Any], plain: Any, metadata: tuple[object, ...]) -> str | None:
    """What stands for a value in the help, where it is not its type or the values that there are."""
    if tyro.conf.Positional not in metadata or plain not in (str, Path):
        return None
    return field.name.upper() if field.default is dataclasses.MISSING else f"[{field.name.upper()}]"


@cache
def _texts(kind: type) -> dict[str, str]:
    """The text below each field of a data class and of those that it inherits from, as one paragraph."""
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
    return out
