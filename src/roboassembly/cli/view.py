"""`roboassembly view`: the studio in the browser."""

from __future__ import annotations

import math
import threading
import webbrowser
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from roboassembly.cli.options import Setting
from roboassembly.cli.output import DONE, print_json, say
from roboassembly.errors import InputError

_PLAN = ".json"
_SLOW = 2.0
"""Seconds after which it is said what is being read."""


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
    """Folders of furniture folders, to choose from, and in which other folders may be opened by name. If none is given,
    `furniture` where it is there, which `roboassembly import` writes; then nothing is opened by name."""
    policies: tuple[str, ...] = ()
    """Policies to choose from, besides the one of the package: checkpoints, or Python files, which are executed."""
    host: str = "127.0.0.1"
    """Address to listen on. 0.0.0.0 lets other machines in, a phone for instance; they need the printed address, which
    has a token in it."""
    port: int = 8080
    """Port to listen on; 0 takes any that is free."""
    token: str = ""
    """Secret of 8 letters or more that the address must contain. By default a random one, and none if only this machine
    can reach --host."""
    allow_origin: tuple[str, ...] = ()
    """Further addresses under which the page is reached, behind a proxy for instance: https://studio.example.org"""
    browser: bool = True
    """Open a browser window."""
    json: bool = False
    """Print one JSON object, with the page's address, on stdout once it can be visited; all else on stderr."""

    def run(self) -> int:
        """Serve until interrupted; returns the exit status."""
        from roboassembly.studio.access import Access
        from roboassembly.studio.config import StudioConfig
        from roboassembly.studio.server import run_studio, silence_connection_messages

        self._check()
        here = Path("furniture")
        folders = self.folders or ((here,) if here.is_dir() else ())
        config = StudioConfig(
            folders=tuple(f for f in folders if any(f.glob("*/furniture.json"))),
            policies=tuple(dict.fromkeys(("relational", *self.policies))),
            furniture=self.furniture,
            scale=self.scale,
            setting=self.setting,
            seed=self.seed,
            roots=self.folders,
        )
        access = Access(self.host, self.token, self.allow_origin, say)
        silence_connection_messages()
        with run_studio(config, access, self.port) as server:
            urls = access.urls(server.get_port())
            for url in urls:
                say(f"{url}  (Ctrl-C ends it)" if url == urls[0] else url)
            if self.json:
                print_json({"success": True, "url": urls[0], "urls": urls})
            if self.browser:
                webbrowser.open(urls[0])
            try:
                threading.Event().wait()
            except KeyboardInterrupt:
                say("closed")
        return DONE

    def _check(self) -> None:
        """Read everything that is named, before anything is served.

        Raises:
            InputError: some of it cannot be used.
        """
        if self.seed < 0:
            raise InputError(f"--seed {self.seed} is negative; 0 or more would do")
        if self.scale is not None and not (math.isfinite(self.scale) and self.scale > 0.0):
            raise InputError(f"--scale {self.scale} is no size; a positive number of metres would do")
        for folder in self.folders:
            if not folder.is_dir():
                raise InputError(f"--folders {folder}: there is no such folder")
        if self.policies:
            from roboassembly.learning.registry import load_policy

            for name in self.policies:
                load_policy(name)
        # The built-in chair that is shown by default is made while the browser loads the page.
        if self.furniture != View.furniture:
            slow = threading.Timer(_SLOW, say, [f"reading {self.furniture} ..."])
            slow.daemon = True
            slow.start()
            try:
                self._check_furniture()
            finally:
                slow.cancel()

    def _check_furniture(self) -> None:
        from roboassembly.studio.assembly_session import AssemblySession
        from roboassembly.studio.sources import open_path, open_plan

        if self.furniture.endswith(_PLAN):
            script, furniture = open_plan(Path(self.furniture))
            AssemblySession(furniture, script.setting, script.seed).check(script)
        else:
            # What is read here is kept for the first who opens the page.
            furniture = open_path(self.furniture, self.scale, with_grasps=self.setting == "full")
            AssemblySession(furniture, self.setting, self.seed)
