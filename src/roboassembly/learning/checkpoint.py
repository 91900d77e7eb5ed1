"""Weights in files: plain arrays and a line of JSON, no code in them; written whole or not at all."""

from __future__ import annotations

import json
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from roboassembly import __version__
from roboassembly.errors import InputError
from roboassembly.learning import archive
from roboassembly.learning.layers import Params

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

FORMAT = 1
REMEDY = "name a file that `roboassembly train` wrote"
_META = "meta.json"
_BETWEEN = "/"
_LARGEST, _DEEPEST = 4096, 64
"""Of any size, and of layers, in a checkpoint's configuration: a broken file must not ask for all memory."""
Config = TypeVar("Config", bound="DataclassInstance")


@dataclass(frozen=True, eq=False)
class Checkpoint:
    """What a file holds."""

    kind: str
    """Which network: `relational`, `paper`, ..."""
    params: Params
    config: dict[str, Any]
    """Of the network and of its training, as JSON."""
    extra: dict[str, np.ndarray]
    """What resuming needs besides: moments of the optimiser, and the like."""


def save(path: Path, checkpoint: Checkpoint, *, half: bool = False) -> None:
    """Write a checkpoint.

    Args:
        half: store weights as 16-bit floats, for shipping.
    """
    arrays: dict[str, Any] = {"params" + _BETWEEN + name: a for name, a in _flat(checkpoint.params)}
    if half:
        arrays = {name: a.astype(np.float16) for name, a in arrays.items()}
    arrays.update({"extra" + _BETWEEN + name: np.asarray(a) for name, a in checkpoint.extra.items()})
    meta = {"format": FORMAT, "version": __version__, "kind": checkpoint.kind, "config": checkpoint.config}
    arrays[_META] = np.frombuffer(json.dumps(meta).encode(), dtype=np.uint8)
    path.parent.mkdir(parents=True, exist_ok=True)
    archive.write(path, arrays)


def load(path: Path, kind: str | None = None, *, remedy: str = REMEDY, largest: int | None = None) -> Checkpoint:
    """Read a checkpoint; 16-bit weights come back as 32-bit.

    Args:
        kind: what it has to be, if given.
        remedy: what a person could name instead of a file that is no checkpoint.
        largest: bytes that all its arrays may unpack to; any number if None.

    Raises:
        InputError: no such file, not a checkpoint, too large, of another format, or of another kind.
    """
    if not path.exists():
        raise InputError(f"no checkpoint at '{path}'; {remedy}")
    with archive.reading(path, "a checkpoint", remedy, largest) as z:
        if _META not in z:
            raise InputError(f"'{path}' is not a checkpoint: it has no {_META}; {remedy}")
        meta = json.loads(bytes(z[_META]).decode())
        arrays = {name: z[name] for name in z if name != _META}
        found, version, config = meta["format"], meta["kind"], meta["config"]
    if not isinstance(config, dict):
        raise InputError(f"'{path}': its configuration is {config!r}, not an object; train again")
    if found != FORMAT:
        raise InputError(f"'{path}' has format {found}, this program reads {FORMAT}; train again")
    if kind is not None and version != kind:
        raise InputError(f"'{path}' holds a '{version}' network where a '{kind}' one is needed")
    params: Params = {}
    extra = {}
    for name, array in arrays.items():
        place, _, rest = name.partition(_BETWEEN)
        if place == "params":
            *above, last = rest.split(_BETWEEN)
            at = params
            for step in above:
                at = at.setdefault(step, {})
            at[last] = array.astype(np.float32) if array.dtype == np.float16 else array
        else:
            extra[rest] = array
    return Checkpoint(version, params, config, extra)


def network_config(usual: Config, found: Any, where: str) -> Config:
    """The sizes of a network from a checkpoint's configuration, checked.

    Args:
        usual: such a configuration, for the names and kinds of its fields.
        found: what the checkpoint has.
        where: the file.

    Raises:
        InputError: it has other fields, or sizes that are none.
    """
    known = {f.name: getattr(usual, f.name) for f in fields(usual)}
    if not isinstance(found, dict) or found.keys() != known.keys():
        told = ", ".join(sorted(found)) if isinstance(found, dict) else repr(found)
        raise InputError(f"'{where}': config['network'] holds {told}; it should hold {', '.join(known)}")
    for name, value in found.items():
        if type(value) is not type(known[name]):
            raise InputError(f"'{where}': config['network']['{name}'] is {value!r}; like {known[name]!r} would do")
        most = _DEEPEST if name == "layers" else _LARGEST
        if isinstance(value, int) and not isinstance(value, bool) and not 1 <= value <= most:
            raise InputError(f"'{where}': config['network']['{name}'] is {value}; 1 to {most} would do")
    return replace(usual, **found)


def check_arrays(found: Params, wanted: Params, where: str, above: str = "") -> None:
    """That a checkpoint's arrays have the names, shapes and kind of numbers of a network.

    Raises:
        InputError: naming the first that does not fit.
    """
    if found.keys() != wanted.keys():
        lacks, more = sorted(wanted.keys() - found.keys()), sorted(found.keys() - wanted.keys())
        raise InputError(
            f"'{where}' does not fit its own configuration: at '{above or '/'}' it lacks {lacks} and has {more} besides"
        )
    for name, value in wanted.items():
        own, at = found[name], f"{above}/{name}"
        if isinstance(value, dict) != isinstance(own, dict):
            raise InputError(f"'{where}': '{at}' is not what its configuration asks for")
        if isinstance(value, dict):
            check_arrays(own, value, where, at)
        elif own.shape != value.shape or own.dtype != value.dtype:
            raise InputError(
                f"'{where}': '{at}' is {own.dtype} {own.shape}; its configuration asks for {value.dtype} {value.shape}"
            )
        elif not np.isfinite(own).all():
            raise InputError(f"'{where}': '{at}' has numbers that are not finite; the training went wrong")


def _flat(params: Params, above: str = "") -> list[tuple[str, np.ndarray]]:
    out = []
    for name, value in params.items():
        if isinstance(value, dict):
            out.extend(_flat(value, f"{above}{name}{_BETWEEN}"))
        else:
            out.append((above + name, np.asarray(value)))
    return out
