// Copyright (C) 2026 the dolfinx_feti authors
//
// SPDX-License-Identifier: LGPL-3.0-or-later
//
// A matrix by block rows. Owner a has width[a] rows and as many columns; its rows have those of the
// owners adjacent[ptr[a]], …, ascending, those of entry e from place[e] on. They stand in values
// from start[a] on, one row after the other.

#include <stdint.h>

// Add an element matrix, row by row, whose rows and columns are those of some owners, ascending.
// Returns 0, or 1 where an owner is not adjacent to another one.
int add_element(int owners, const int *owner, const double *element, const int *width,
                const int *ptr, const int *adjacent, const int *place, const int64_t *start,
                double *values)
{
    for (int s = 0; s < owners; ++s) {
        const int a = owner[s];
        const int64_t length = (start[a + 1] - start[a]) / (width[a] ? width[a] : 1);
        for (int i = 0; i < width[a]; ++i) {
            double *row = values + start[a] + i * length;
            for (int t = 0, e = ptr[a]; t < owners; ++t) {
                while (e < ptr[a + 1] && adjacent[e] != owner[t]) ++e;
                if (e == ptr[a + 1]) return 1;
                double *to = row + place[e];
                for (int j = 0; j < width[owner[t]]; ++j) to[j] += *element++;
            }
        }
    }
    return 0;
}
