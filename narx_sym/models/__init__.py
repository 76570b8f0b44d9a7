"""Models as expressions: structure, pools, effects added to them, and what follows at rest."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach(__name__, submodules=["analysis", "assumptions", "effects"])
