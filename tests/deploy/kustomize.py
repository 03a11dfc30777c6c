"""Builds the manifests of a kustomization, for machines without kubectl: what `deploy/kubernetes` uses of kustomize."""

from __future__ import annotations

import copy
from pathlib import Path
from typing import Any

import yaml

Manifest = dict[str, Any]
LOCAL = "config.kubernetes.io/local-config"  # annotation of what is not to be created
KNOWN = {"apiVersion", "kind", "namespace", "resources", "images", "patches", "replacements"}


def build(folder: Path) -> list[Manifest]:
    """All manifests, with patches, replacements, images and the namespace applied."""
    return [m for m in _build(folder) if (m["metadata"].get("annotations") or {}).get(LOCAL) != "true"]


def _build(folder: Path) -> list[Manifest]:
    settings = yaml.safe_load((folder / "kustomization.yaml").read_text())
    assert set(settings) <= KNOWN, f"{folder}: this does not know {set(settings) - KNOWN}"
    manifests: list[Manifest] = []
    for name in settings["resources"]:
        path = folder / name
        manifests += _build(path) if path.is_dir() else yaml.safe_load_all(path.read_text())
    for patch in settings.get("patches", ()):
        for operation in yaml.safe_load(patch["patch"]):
            _patch(_select(manifests, patch["target"]), operation)
    for replacement in settings.get("replacements", ()):
        source = replacement["source"]
        value = _select(manifests, source)[source["fieldPath"]]
        for target in replacement["targets"]:
            for path in target["fieldPaths"]:
                *parents, last = path.split(".")
                _at(_select(manifests, target["select"]), parents)[last] = copy.deepcopy(value)
    for manifest in manifests:
        if "namespace" in settings:
            manifest["metadata"]["namespace"] = settings["namespace"]
        for image in settings.get("images", ()):
            _set_image(manifest, image["name"], f"{image['newName']}:{image['newTag']}")
    return manifests


def _select(manifests: list[Manifest], target: Manifest) -> Manifest:
    (found,) = [m for m in manifests if (m["kind"], m["metadata"]["name"]) == (target["kind"], target["name"])]
    return found


def _at(value: Any, keys: list[str]) -> Any:
    for key in keys:
        value = value[int(key)] if isinstance(value, list) else value[key]
    return value


def _patch(manifest: Manifest, operation: Manifest) -> None:
    """Apply one operation of a JSON patch."""
    *parents, last = operation["path"].strip("/").split("/")
    parent = _at(manifest, parents)
    assert operation["op"] in ("add", "replace")
    assert operation["op"] == "add" or last in parent, f"there is no {operation['path']} to replace"
    parent[last] = operation["value"]


def _set_image(value: Any, name: str, image: str) -> None:
    for part in value.values() if isinstance(value, dict) else value if isinstance(value, list) else ():
        if isinstance(part, dict) and part.get("image") == name:
            part["image"] = image
        _set_image(part, name, image)
