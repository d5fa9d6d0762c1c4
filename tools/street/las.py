# SPDX-License-Identifier: Apache-2.0
"""LAS 1.2, point format 1, uncompressed (ASPRS LAS Specification 1.2): millimetres, one return a pulse."""
import struct

import numpy as np

SCALE_M = 0.001
RECORD = np.dtype(
    [
        ("x", "<i4"),
        ("y", "<i4"),
        ("z", "<i4"),
        ("intensity", "<u2"),
        ("returns", "u1"),
        ("class", "u1"),
        ("angle", "i1"),
        ("user", "u1"),
        ("source", "<u2"),
        ("gps_time", "<f8"),
    ]
)
HEADER_BYTES = 227


def write(path, points_m, intensity, gps_time):
    """points_m [n, 3]; intensity [n] 0..255; gps_time [n] in any unit (the dataset: nanoseconds of the host clock)."""
    records = np.zeros(len(points_m), RECORD)
    mm = np.round(np.asarray(points_m) / SCALE_M).astype(np.int64)
    for axis, name in enumerate("xyz"):
        records[name] = mm[:, axis]
    records["intensity"], records["gps_time"] = intensity, gps_time
    records["returns"] = 1 | 1 << 3  # return 1 of 1
    low, high = (mm.min(0) * SCALE_M, mm.max(0) * SCALE_M) if len(mm) else (np.zeros(3), np.zeros(3))
    header = struct.pack(
        "<4sHH16sBB32s32sHHHIIBHI5I",
        b"LASF",
        0,
        0,
        bytes(16),
        1,
        2,
        b"redrive",
        b"tools/street",
        0,
        0,
        HEADER_BYTES,
        HEADER_BYTES,
        0,
        1,
        RECORD.itemsize,
        len(mm),
        len(mm),
        0,
        0,
        0,
        0,
    )
    header += struct.pack("<12d", *[SCALE_M] * 3, 0, 0, 0, *[v for pair in zip(high, low) for v in pair])
    assert len(header) == HEADER_BYTES and RECORD.itemsize == 28
    path.write_bytes(header + records.tobytes())
