"""`roboassembly view`: the studio in the browser."""

from __future__ import annotations

import threading
import webbrowser
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from roboassembly.cli.options import Setting
from roboassembly.cli.output import DONE, print_json, say
from roboassembly.errors import InputError


@dataclass(frozen=True)
class View:
    """Put furniture together in the browser: by hand, by a policy or by the search."""

    furniture: Annotated[str, tyro.conf.Positional] = "ladder"
    """Shown at first: a built-in chair (`ladder`, `windsor:3`, ...), a furniture folder, or 3D files: a folder of STL,
    OBJ, PLY or GLB files, one a part, or one GLB scene; or a plan.json, which is done again."""
    setting: Setting = "object-centric"
    """What moves the parts at first: they fly by themselves, or two mobile Frankas move them."""
    seed: int = 0
    """Where the parts lie at first, and what the planner draws."""
    scale: float | None = None
    """Metres per unit of 3D files; guessed if not given."""
    folders: tuple[Path, ...] = ()
    """Folders of furniture folders, to choose from. If none is given, `furniture` where it is there: what
    `roboassembly import` writes."""
    policies: tuple[str, ...] = ()
    """Checkpoints to choose from, besides the policy of the package."""
    host: str = "127.0.0.1"
    """Address to listen on. 0.0.0.0 lets other machines in, a phone for instance; whoever can reach it can use it."""
    port: int = 8080
    """To listen on; 0 takes any that is free."""
    browser: bool = True
    """Open a browser window."""
    json: bool = False
    """Print one JSON object, with the page's address, on stdout once it can be visited; all else on stderr."""

    def run(self) -> int:
        """Serve until interrupted; returns the exit status."""
        from roboassembly.studio.house import House
        from roboassembly.studio.server import LOOPBACK, silence, studio

        if self.seed < 0:
            raise InputError(f"--seed {self.seed} is negative; 0 or more would do")
        for folder in self.folders:
            if not folder.is_dir():
                raise InputError(f"--folders {folder}: there is no such folder")
        here = Path("furniture")
        folders = self.folders or ((here,) if here.is_dir() else ())
        if self.furniture != View.furniture and not Path(self.furniture).exists():
            # Names are told at once to be wrong; all else is read or made while the browser loads the page.
            from roboassembly.studio.wares import open_path

            open_path(self.furniture, self.scale, with_grasps=self.setting == "full")
        house = House(
            tuple(f for f in folders if any(f.glob("*/furniture.json"))),
            ("relational", *self.policies),
            self.furniture,
            self.scale,
            self.setting,
            self.seed,
            self.host in LOOPBACK,
        )
        silence()
        with studio(house, self.host, self.port) as server:
            name = "localhost" if self.host in (*LOOPBACK, "0.0.0.0", "::") else self.host
            url = f"http://{name}:{server.get_port()}"
            say(f"{url}  (Ctrl-C ends it)")
            if self.json:
                print_json({"success": True, "url": url})
            if self.browser:
                webbrowser.open(url)
            try:
                threading.Event().wait()
            except KeyboardInterrupt:
                say("closed")
        return DONE
