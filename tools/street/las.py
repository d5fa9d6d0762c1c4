# SPDX-License-Identifier: Apache-2.0
"""LAS 1.2, point formats 0 and 1, uncompressed (ASPRS LAS Specification 1.2): millimetres, one return a pulse."""
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
    ]
)
TIMED = np.dtype(RECORD.descr + [("gps_time", "<f8")])
HEADER_BYTES = 227


def write(path, points_m, intensity, gps_time=None, channel=0):
    """points_m [n, 3]; intensity [n] 0..255; gps_time [n] in any unit (the dataset: nanoseconds of the host clock), or
    None: format 0 has no times; channel [n], as user data."""
    kind = RECORD if gps_time is None else TIMED
    records = np.zeros(len(points_m), kind)
    mm = np.round(np.asarray(points_m) / SCALE_M).astype(np.int64)
    for axis, name in enumerate("xyz"):
        records[name] = mm[:, axis]
    records["intensity"], records["user"] = intensity, channel
    if gps_time is not None:
        records["gps_time"] = gps_time
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
        int(kind is TIMED),
        kind.itemsize,
        len(mm),
        len(mm),
        0,
        0,
        0,
        0,
    )
    header += struct.pack("<12d", *[SCALE_M] * 3, 0, 0, 0, *[v for pair in zip(high, low) for v in pair])
    assert len(header) == HEADER_BYTES and (RECORD.itemsize, TIMED.itemsize) == (20, 28)
    path.write_bytes(header + records.tobytes())
