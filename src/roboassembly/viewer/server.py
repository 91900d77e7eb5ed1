"""viser's server, for pages that are written and for the studio; light, so that it can listen before all else."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import rich
from viser import ViserServer


@contextmanager
def quiet_server(host: str, port: int) -> Iterator[ViserServer]:
    """A viser server that does not announce itself, shows no axes of the world, and is gone afterwards.

    viser records only through a server, too. It announces itself through rich's console, from two threads, whatever
    `verbose` says; so that console is kept quiet meanwhile.

    Args:
        host: address to listen on.
        port: any free one if 0.
    """
    console = rich.get_console()
    was_quiet, console.quiet = console.quiet, True
    try:
        server = ViserServer(host=host, port=port, verbose=False)
        server.scene.world_axes.visible = False
        try:
            yield server
        finally:
            server.stop()
    finally:
        console.quiet = was_quiet
