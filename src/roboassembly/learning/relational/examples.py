"""Examples for the network: the tokens of labelled states with the targets, kept in files.

Tokens take longer to compute than a network takes to learn from them once, so they are kept beside the samples.
"""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import MISSING, dataclass, fields, replace
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np
from jaxtyping import UInt8

from roboassembly.learning import archive
from roboassembly.learning.datasets import SampleSet, check_format, dataset_file
from roboassembly.learning.relational.oracle_dataset import targets_of
from roboassembly.learning.relational.own_frames import in_own_frames
from roboassembly.learning.relational.tokens import TokenCache, Tokens, tokens_of_sample
from roboassembly.parallel.processes import map_ordered

Frames = Literal["aligned", "own", "both"]
"""Frames in which a run shows its samples; `both` shows a third of the pieces aligned, the others in own frames."""
SHOWN: dict[Frames, tuple[Frames, ...]] = {"aligned": ("aligned",), "own": ("own",), "both": ("aligned", "own")}
"""Frames in which a run is validated."""
FORMAT = 2
"""Version of the files."""
_MIN_FOR_PROCESSES = 8
"""Number of pieces from which on their examples are prepared in several processes."""
_NOISES = (0.0, 0.0, 0.0, 0.0, 0.0005, 0.001)
"""Standard deviations of the clouds' noise in own frames [m]; one is drawn for each piece."""
_IMPRECISION = 0.0004
"""Largest standard deviation of the connection points in own frames [m], drawn for half of the pieces: surfaces in
contact do not meet exactly."""
_REMEDY = "remove it; it is built again from the samples"


@dataclass(frozen=True, eq=False)
class TokenExample:
    """A labelled state with n tokens, ready for the network and small enough to keep a hundred thousand."""

    tokens: Tokens
    """Tokens; `bounds` as 16-bit floats."""
    fits: UInt8[np.ndarray, "n n"]
    """Whether each ordered pair fits."""
    viable: UInt8[np.ndarray, "n n 6"]
    """Whether each action is viable."""


def examples_of(sample_sets: Sequence[SampleSet]) -> list[TokenExample]:
    """Return the examples of all samples."""
    out: list[TokenExample] = []
    for samples in sample_sets:
        cache = TokenCache()
        for sample in samples.samples:
            tokens = tokens_of_sample(samples, sample, cache)
            small = replace(tokens, bounds=tokens.bounds.astype(np.float16))
            out.append(TokenExample(small, *targets_of(tokens, sample)))
    return out


def load_examples(folder: Path, names: Sequence[str], jobs: int, frames: Frames = "both") -> list[TokenExample]:
    """Return the examples of some pieces, prepared in parallel; those that were prepared before are read.

    Args:
        folder: folder of the samples; examples are kept in its subfolder `examples`.
        names: names of the pieces.
        jobs: number of processes.
        frames: frames in which the samples are shown.

    Raises:
        InputError: a file of samples is broken.
    """
    (folder / "examples").mkdir(exist_ok=True)
    paths = [dataset_file(folder, name) for name in names]
    work = partial(prepare, frames=frames)
    prepared = list(map_ordered(work, paths, 1 if len(paths) < _MIN_FOR_PROCESSES else jobs, chunk=4))
    return [example for path in prepared for example in _read(path)]


def prepare(path: Path, frames: Frames = "both") -> Path:
    """Prepare the examples of a file of samples unless they exist; returns their file."""
    number = zlib.crc32(path.stem.encode())
    shown = frames if frames != "both" else "aligned" if number % 3 == 0 else "own"
    target = path.parent / "examples" / f"{path.stem}.{shown}.npz"
    if not target.is_file():
        samples = SampleSet.load(path)
        if shown == "own" and samples.samples:
            rng = np.random.default_rng(number)
            noise, imprecision = rng.choice(_NOISES), max(rng.uniform(-_IMPRECISION, _IMPRECISION), 0.0)
            samples = in_own_frames(samples, rng, float(noise), float(imprecision))
        _write(target, examples_of([samples]))
    return target


def _write(path: Path, examples: Sequence[TokenExample]) -> None:
    """Write examples; each array of all states follows that of the state before."""
    # Training does without the fields that have a default.
    names = [f.name for f in fields(Tokens) if examples and f.default is MISSING]
    arrays = {"format": np.array(FORMAT), "tokens": np.array([len(e.fits) for e in examples], int)}
    for name in names:
        arrays[name] = np.concatenate([getattr(e.tokens, name).ravel() for e in examples])
        arrays[f"{name}.shape"] = np.array([getattr(e.tokens, name).shape for e in examples], int)
    for name in ("fits", "viable") if examples else ():
        arrays[name] = np.concatenate([getattr(e, name).ravel() for e in examples])
    archive.write(path, arrays)


def _read(path: Path) -> list[TokenExample]:
    """Read what `_write` wrote.

    Raises:
        InputError: the file is broken.
    """
    with archive.reading(path, "a file of examples", _REMEDY) as z:
        check_format(path, z, FORMAT)
        count = z["tokens"].tolist()
        split: dict[str, list[Any]] = {}
        for f in fields(Tokens) if count else ():
            if f.name in z:
                shapes = z[f"{f.name}.shape"]
                flat = np.split(z[f.name], np.cumsum(shapes.prod(axis=1))[:-1])
                split[f.name] = [a.reshape(shape) for a, shape in zip(flat, shapes, strict=True)]
        sizes = np.array(count, int) ** 2
        targets = {
            name: np.split(z[name], np.cumsum(sizes * width)[:-1]) if count else []
            for name, width in (("fits", 1), ("viable", 6))
        }
    return [
        TokenExample(
            Tokens(**{name: arrays[i] for name, arrays in split.items()}),
            targets["fits"][i].reshape(n, n),
            targets["viable"][i].reshape(n, n, 6),
        )
        for i, n in enumerate(count)
    ]
