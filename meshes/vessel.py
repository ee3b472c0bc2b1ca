# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""The wall of a vessel from the command line: ``python3 -m meshes.vessel vessel.xdmf``."""

from dolfinx_feti.meshes.vessel import main

if __name__ == "__main__":
    main()
