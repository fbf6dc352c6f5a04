"""Rigged hands from files, skinned glTF 2.0 and MANO models, posed by the poses of `clradar.hand`.

Bone axes are estimated from the joints, which also check unit and side; linear blend skinning gives
the surface; see ``docs/rigs.md``.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
