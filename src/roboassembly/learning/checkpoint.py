"""Checkpoints: weights in npz files, plain arrays and a line of JSON without code, written whole or not at all."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar, cast

import numpy as np

from roboassembly import __version__
from roboassembly.errors import InputError
from roboassembly.learning import archive
from roboassembly.learning.layers import Params

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

FORMAT = 2
"""Version of the files."""
REMEDY = "name a file that `roboassembly train` wrote"
_META = "meta.json"
_SEPARATOR = "/"
_MAX_SIZE, _MAX_LAYERS = 4096, 64
"""Largest sizes in the configuration of a network: a broken file must not ask for all memory."""
Config = TypeVar("Config", bound="DataclassInstance")


@dataclass(frozen=True, eq=False)
class Checkpoint:
    """Content of a file."""

    kind: str
    """Kind of network: `relational`, `paper`, ..."""
    params: Params
    """Weights."""
    config: dict[str, Any]
    """Configuration of the network and of its training, as JSON."""
    extra: dict[str, np.ndarray]
    """Further arrays that continuing needs: state of the optimiser, step, ..."""


def save(path: Path, checkpoint: Checkpoint, *, half: bool = False) -> None:
    """Write a checkpoint.

    Args:
        path: file.
        checkpoint: content.
        half: whether weights are stored as 16-bit floats, for shipping.
    """
    arrays: dict[str, Any] = {"params" + _SEPARATOR + name: a for name, a in _flat(checkpoint.params)}
    if half:
        arrays = {name: a.astype(np.float16) for name, a in arrays.items()}
    arrays.update({"extra" + _SEPARATOR + name: np.asarray(a) for name, a in checkpoint.extra.items()})
    meta = {"format": FORMAT, "version": __version__, "kind": checkpoint.kind, "config": checkpoint.config}
    arrays[_META] = np.frombuffer(json.dumps(meta).encode(), dtype=np.uint8)
    path.parent.mkdir(parents=True, exist_ok=True)
    archive.write(path, arrays)


def load(path: Path, kind: str | None = None, *, remedy: str = REMEDY, largest: int | None = None) -> Checkpoint:
    """Read a checkpoint; 16-bit weights become 32-bit.

    Args:
        path: file.
        kind: kind of network that it must hold; any if None.
        remedy: advice in messages about a file that is no checkpoint.
        largest: largest unpacked size of all arrays [bytes]; any if None.

    Raises:
        InputError: there is no such file, or it is no checkpoint, too large, of another format, or of another kind.
    """
    if not path.exists():
        raise InputError(f"no checkpoint at '{path}'; {remedy}")
    with archive.reading(path, "a checkpoint", remedy, largest) as z:
        if _META not in z:
            raise InputError(f"'{path}' is not a checkpoint: it has no {_META}; {remedy}")
        meta = json.loads(bytes(z[_META]).decode())
        arrays = {name: z[name] for name in z if name != _META}
        version, found, config = meta["format"], meta["kind"], meta["config"]
    if not isinstance(config, dict):
        raise InputError(f"'{path}': its configuration is {config!r}, not an object; train again")
    if version != FORMAT:
        raise InputError(f"'{path}' has format {version}, this program reads {FORMAT}; train again")
    if kind is not None and found != kind:
        raise InputError(f"'{path}' holds a '{found}' network where a '{kind}' one is needed")
    params: Params = {}
    extra: dict[str, np.ndarray] = {}
    for name, array in arrays.items():
        section, _, rest = name.partition(_SEPARATOR)
        if section == "params":
            *above, last = rest.split(_SEPARATOR)
            at = params
            for step in above:
                at = at.setdefault(step, {})
            at[last] = array.astype(np.float32) if array.dtype == np.float16 else array
        else:
            extra[rest] = array
    return Checkpoint(found, params, cast("dict[str, Any]", config), extra)


def arrays_hash(params: Params) -> str:
    """Return a hash of names and values of all arrays, as they are after storage as 16-bit floats."""
    digest = hashlib.sha256()
    for name, array in sorted(_flat(params)):
        digest.update(name.encode())
        digest.update(np.ascontiguousarray(array.astype(np.float16)).tobytes())
    return digest.hexdigest()[:16]


def network_config(default: Config, found: Any, where: str) -> Config:
    """Return the sizes of a network from the configuration of a checkpoint, checked.

    Args:
        default: such a configuration, which gives the names and types of the fields.
        found: configuration in the checkpoint.
        where: file, for messages.

    Raises:
        InputError: it has other fields, or values that are no sizes.
    """
    known = {f.name: getattr(default, f.name) for f in fields(default)}
    if not isinstance(found, dict) or found.keys() != known.keys():
        names = ", ".join(sorted(cast("dict[str, Any]", found))) if isinstance(found, dict) else repr(found)
        raise InputError(f"'{where}': config['network'] holds {names}; it should hold {', '.join(known)}")
    sizes = cast("dict[str, Any]", found)
    for name, value in sizes.items():
        if type(value) is not type(known[name]):
            raise InputError(f"'{where}': config['network']['{name}'] is {value!r}; expected one like {known[name]!r}")
        most = _MAX_LAYERS if name == "layers" else _MAX_SIZE
        if isinstance(value, int) and not isinstance(value, bool) and not 1 <= value <= most:
            raise InputError(f"'{where}': config['network']['{name}'] is {value}; expected 1 to {most}")
    return replace(default, **sizes)


def check_arrays(found: Params, expected: Params, where: str, above: str = "") -> None:
    """Check that the arrays of a checkpoint have the names, shapes and types of a network's.

    Args:
        found: arrays of the checkpoint.
        expected: arrays of such a network.
        where: file, for messages.
        above: path of the arrays in the checkpoint.

    Raises:
        InputError: names the first array that does not fit.
    """
    if found.keys() != expected.keys():
        lacks, more = sorted(expected.keys() - found.keys()), sorted(found.keys() - expected.keys())
        raise InputError(
            f"'{where}' does not fit its own configuration: at '{above or '/'}' it lacks {lacks} and has {more} besides"
        )
    for name, value in expected.items():
        own, at = found[name], f"{above}/{name}"
        if isinstance(value, dict) != isinstance(own, dict):
            raise InputError(f"'{where}': '{at}' is not what its configuration asks for")
        if isinstance(value, dict):
            check_arrays(own, cast("Params", value), where, at)
        elif own.shape != value.shape or own.dtype != value.dtype:
            raise InputError(
                f"'{where}': '{at}' is {own.dtype} {own.shape}; its configuration asks for {value.dtype} {value.shape}"
            )
        elif not np.isfinite(own).all():
            raise InputError(f"'{where}': '{at}' has numbers that are not finite; the training went wrong")


def _flat(params: Params, above: str = "") -> list[tuple[str, np.ndarray]]:
    """Return all arrays with their paths."""
    out: list[tuple[str, np.ndarray]] = []
    for name, value in params.items():
        if isinstance(value, dict):
            out.extend(_flat(cast("Params", value), f"{above}{name}{_SEPARATOR}"))
        else:
            out.append((above + name, np.asarray(value)))
    return out
