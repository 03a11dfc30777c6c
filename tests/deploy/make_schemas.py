"""Writes the schemas of the custom resources that the manifests use: `python -m tests.deploy.make_schemas FILE ...`.

Each FILE is a CustomResourceDefinition of KubeRay (ray-operator/config/crd/bases) or of the Prometheus operator
(example/prometheus-operator-crd), both under the Apache License 2.0. Descriptions are left out.
"""

from __future__ import annotations

import gzip
import json
import sys
from pathlib import Path
from typing import Any

import yaml

SCHEMAS = Path(__file__).parent / "schemas"


def without_descriptions(value: Any) -> Any:
    if isinstance(value, dict):
        return {
            key: without_descriptions(part)
            for key, part in value.items()
            if not (key == "description" and isinstance(part, str))
        }
    return [without_descriptions(part) for part in value] if isinstance(value, list) else value


def main() -> None:
    for name in sys.argv[1:]:
        definition = yaml.safe_load(Path(name).read_text())
        kind = definition["spec"]["names"]["kind"]
        (schema,) = (
            version["schema"]["openAPIV3Schema"]
            for version in definition["spec"]["versions"]
            if version["name"] == "v1"
        )
        text = json.dumps(without_descriptions(schema), separators=(",", ":"))
        (SCHEMAS / f"{kind}.json.gz").write_bytes(gzip.compress(text.encode(), 9, mtime=0))


if __name__ == "__main__":
    main()
