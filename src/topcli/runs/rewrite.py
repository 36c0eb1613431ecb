"""Rewrite a finished run in another format: the tables from those stored, bit for bit, in a folder that replaces it."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

from topcli.runs.identity import Identity, table_metadata
from topcli.store.manifest import StoredRun, stored_run
from topcli.store.parts import is_result, remove_own
from topcli.store.provenance import now
from topcli.store.run_folder import RunWriter
from topcli.store.series import copy_series

_TABLES = ("series", "trajectories")
"""Entries of a manifest that name tables; they are the same file if an ensemble keeps no rows."""


def rewrite_run(identity: Identity, existing: StoredRun, out: Path) -> tuple[StoredRun, Path | None]:
    """Write the finished run ``existing`` in the format of ``identity`` and put the new folder in its place.

    The earlier folder is removed after the new one is complete; if it holds files of the user it is renamed instead,
    to the path returned beside the run. Raises RunError if reading or writing fails; the earlier run is then unchanged.
    """
    manifest, suffix = existing.manifest, identity.config["output"]["format"]
    renamed = {manifest[key]: f"{Path(manifest[key]).stem}.{suffix}" for key in _TABLES if key in manifest}
    with RunWriter(out, identity.name, identity.digests, displace=False) as writer:
        try:
            for name in manifest["files"]:
                if name in renamed:
                    metadata = table_metadata(identity, manifest.get("environment", {}))
                    target = writer.folder / renamed[name]
                    writer.sha256[target.name] = copy_series(existing.folder / name, target, metadata, _ended(manifest))
                elif is_result(name):
                    shutil.copyfile(existing.folder / name, writer.folder / name)
            from topcli.config.yaml_text import to_yaml

            writer.write("config.yaml", to_yaml(identity.config))
            kept = {key: value for key, value in manifest.items() if key not in ("manifest_version", "files")}
            tables = {key: renamed[manifest[key]] for key in _TABLES if key in manifest}
            rewritten = {"from": sorted(renamed), "at": now()}
            stored = writer.commit(
                {**kept, **tables, "name": identity.name, "config": identity.config, "rewritten": rewritten}
            )
        except OSError as error:
            if stored_run(existing.folder) is not None:  # not moved yet: the unplaced copy is of no use
                remove_own(writer.folder)
            raise writer.failure(error, f"the run is kept as {existing.series.suffix[1:]}") from error
    return stored, writer.set_aside


def _ended(manifest: dict[str, Any]) -> dict[str, str]:
    """Metadata of tables that are known at the end of a run."""
    ended = {"topcli.outcome": manifest["outcome"], "topcli.message": manifest.get("message", "")}
    left = manifest.get("left_motion")
    return ended if left is None else {**ended, "topcli.left_motion": json.dumps(left)}
