# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
"""Output: recovered stresses, values at points, fields for ParaView, pictures, and scenes.

In the order of the data: evaluation, patches, stress, file_fields, point_cloud, file_formats,
fields, surfaces, pictures, scenes.
"""

from dolfinx_feti.output.evaluation import cell_values, evaluate
from dolfinx_feti.output.fields import FieldWriter
from dolfinx_feti.output.patches import Patches, create_patches
from dolfinx_feti.output.stress import balanced_stress, recovered_field
from dolfinx_feti.runtime.folders import writable_folder

__all__ = [
    "FieldWriter",
    "Patches",
    "balanced_stress",
    "cell_values",
    "create_patches",
    "evaluate",
    "recovered_field",
    "writable_folder",
]
