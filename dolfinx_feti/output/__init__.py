# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Output: fields for ParaView.

In the order of the data: fields.
"""

from dolfinx_feti.folders import writable_folder
from dolfinx_feti.output.fields import FieldWriter, cell_values

__all__ = ["FieldWriter", "cell_values", "writable_folder"]
