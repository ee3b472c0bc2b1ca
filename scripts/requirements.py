# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Print what pip has to install for the package, its extras, and groups of `pyproject.toml`.

python3 scripts/requirements.py GROUP…
"""

import sys
import tomllib
from pathlib import Path

data = tomllib.loads((Path(__file__).parents[1] / "pyproject.toml").read_text(encoding="utf-8"))


def group(name: str) -> list[str]:
    """Return the requirements of a group (PEP 735), with those of the groups that it includes."""
    lines: list[str] = []
    for line in data["dependency-groups"][name]:
        lines += [line] if isinstance(line, str) else group(line["include-group"])
    return lines


needs = set(data["project"]["dependencies"]).union(
    *data["project"]["optional-dependencies"].values(), *map(group, sys.argv[1:])
)
print(*sorted(needs), sep="\n")
