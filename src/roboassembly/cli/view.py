"""`roboassembly view`: the studio, a web page to assemble furniture interactively."""

from __future__ import annotations

import math
import threading
import webbrowser
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from roboassembly.cli.options import Setting, require_at_least
from roboassembly.cli.output import DONE, print_json, say
from roboassembly.errors import InputError

_PLAN = ".json"
_SLOW = 2.0
"""Time after which a message says what is being read [s]."""


@dataclass(frozen=True)
class ViewCommand:
    """Assemble furniture in the browser: by hand, by a policy or by the search."""

    furniture: Annotated[str, tyro.conf.Positional] = "ladder"
    """Furniture to open: a built-in piece (`FAMILY` or `FAMILY:SEED`), a furniture folder, a GLB scene, or a folder
    with one STL, OBJ, PLY or GLB file per part; or a plan.json, which is planned and checked again."""
    setting: Setting = "object-centric"
    """The page can change it."""
    seed: int = 0
    """Random seed of the initial placement and of the planner, at first."""
    scale: float | None = None
    """Scale of 3D files in metres per unit. Without it: estimated from typical sizes of furniture."""
    folders: tuple[Path, ...] = ()
    """Folders of furniture folders to choose from; the page can also open other folders in them by name. Without it:
    `furniture`, where `roboassembly import` writes to, without opening by name."""
    policies: tuple[str, ...] = ()
    """Additional policies to choose from: checkpoints, or Python files, which are executed."""
    host: str = "127.0.0.1"
    """Address to listen on. 0.0.0.0 admits other machines, such as a phone; they need the printed address, which
    contains a token."""
    port: int = 8080
    """Port to listen on; 0 for any free port."""
    token: str = ""
    """Secret of 8 characters or more that the address must contain. Without it: a random one, or none if only this
    machine can reach --host."""
    allow_origin: tuple[str, ...] = ()
    """Further addresses of the page, for example behind a proxy: https://studio.example.org"""
    browser: bool = True
    """Open a browser window."""
    json: bool = False
    """Print one JSON object with the address of the page on stdout once it is served, and everything else on stderr."""

    def run(self) -> int:
        """Serve the page until interrupted; returns the exit status."""
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
                say(f"{url}  (stop with Ctrl-C)" if url == urls[0] else url)
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
        """Check all options and read all named files before the server starts.

        Raises:
            InputError: an option or a file is not valid.
        """
        require_at_least(0, seed=self.seed)
        if self.scale is not None and not (math.isfinite(self.scale) and self.scale > 0.0):
            raise InputError(
                f"--scale {self.scale} is not a positive number; give metres per unit of the files, such as 0.001"
            )
        for folder in self.folders:
            if not folder.is_dir():
                raise InputError(f"--folders {folder} does not exist or is not a folder")
        if self.policies:
            from roboassembly.learning.registry import load_policy

            for name in self.policies:
                load_policy(name)
        # The default furniture is generated while the browser loads the page.
        if self.furniture != ViewCommand.furniture:
            slow = threading.Timer(_SLOW, say, [f"reading {self.furniture} ..."])
            slow.daemon = True
            slow.start()
            try:
                self._check_furniture()
            finally:
                slow.cancel()

    def _check_furniture(self) -> None:
        from roboassembly.settings import SETTINGS
        from roboassembly.studio.assembly_session import AssemblySession
        from roboassembly.studio.sources import open_path, open_plan

        if self.furniture.endswith(_PLAN):
            script, furniture = open_plan(Path(self.furniture))
            AssemblySession(furniture, script.setting, script.seed).check(script)
        else:
            # The result is cached for the first client.
            furniture = open_path(self.furniture, self.scale, with_grasps=SETTINGS[self.setting].needs_grasps)
            AssemblySession(furniture, self.setting, self.seed)
