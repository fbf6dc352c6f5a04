"""Changes to the members of zip archives; the archive around them is written anew."""

from __future__ import annotations

import io
import random
import warnings
import zipfile

from fuzz import mutate_bytes

DICTIONARY = (b"PK\x03\x04", b"PK\x01\x02", b"PK\x05\x06", b".npy", b"'descr'", b"'<c8'", b"'|O'")
_NAMES = ("s.npy", "s", "../s.npy", "/s.npy", "", "f.npy", "s.npy/", "\u2028.npy")


def mutate_members(data: bytes, rng: random.Random) -> bytes:
    """Return the archive with a member changed, doubled, renamed or left out."""
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            members = [(name, archive.read(name)) for name in archive.namelist()]
    except Exception:
        return data
    if not members:
        return data
    at = rng.randrange(len(members))
    name, content = members[at]
    kind = rng.randrange(4)
    if kind == 0:
        del members[at]
    elif kind == 1:
        members[at] = (rng.choice(_NAMES), content)
    else:
        others = tuple(c for _, c in members)
        members[at] = (name, mutate_bytes.mutate(content, rng, DICTIONARY, others))
    stream = io.BytesIO()
    how = rng.choice((zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED))
    with warnings.catch_warnings(), zipfile.ZipFile(stream, "w", how) as archive:
        warnings.simplefilter("ignore")  # two members of one name are meant
        for name, content in members:
            archive.writestr(zipfile.ZipInfo(name or "?"), content, how)
    return stream.getvalue()
