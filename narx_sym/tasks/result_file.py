"""What the commands found as JSON: a diagnosis in the published schema, and plain figures."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

from ..diagnosis.procedure import Diagnosis
from ..files.atomic import write_text
from ..models.continuous_time import Continuous
from .physical import physical, plain_rows


def write_json(
    found: Diagnosis, path: Path, experiment: str | None, quantities: Continuous | str | None = None
) -> None:
    """Write a diagnosis in the published schema: sorted keys, no NaN, `seconds` last.

    Parameters
    ----------
    quantities : what `physical` returned, where it is known already
    """
    quantities = physical(found, found.units) if quantities is None else quantities
    plain = finite(found.to_dict(experiment) | {"physical": plain_rows(quantities)})
    seconds = plain.pop("seconds")
    text = json.dumps(plain, indent=1, sort_keys=True, allow_nan=False)
    write_text(path, f'{text[:-2]},\n "seconds": {json.dumps(seconds)}\n}}\n')


def write_plain(rows: dict[str, Any], path: Path) -> None:
    """Write plain data: sorted keys, null for what is not finite."""
    write_text(path, json.dumps(finite(rows), indent=1, sort_keys=True, allow_nan=False) + "\n")


def finite(value: Any) -> Any:
    """Replace what JSON cannot say, NaN and infinity, by null."""
    if isinstance(value, dict):
        return {str(n): finite(v) for n, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [finite(v) for v in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value
