# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""A two-layer tube from the command line: ``python3 -m meshes.tube tube.xdmf``."""

from dolfinx_feti.meshes.tube import main

if __name__ == "__main__":
    main()
