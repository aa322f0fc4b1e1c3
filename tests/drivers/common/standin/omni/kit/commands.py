from __future__ import annotations

from typing import Any

import isaacsim


class ImportConfig:
    fixed = False

    def set_fix_base(self, on: bool) -> None:
        self.fixed = on

    def set_import_inertia_tensor(self, on: bool) -> None: ...


def execute(name: str, **given: Any) -> tuple[bool, Any]:
    assert ("extension", "isaacsim.asset.importer.mjcf") in isaacsim.calls, (
        "the extension of this command is not enabled"
    )
    if name == "MJCFCreateImportConfig":
        return True, ImportConfig()
    assert name == "MJCFCreateAsset" and given["import_config"].fixed
    isaacsim.take(given["prim_path"], given["mjcf_path"])
    return True, given["prim_path"]
