"""For tools on top of the package, as its studio is: what emulators look like, their programs, and files kept whole.

    from neuroanimator.authoring import checked_wasm, definition_of, write_whole

Names may change with a release, and the changelog then says so.
"""

from __future__ import annotations

from neuroanimator.lazy import lazy_names

__getattr__, __dir__ = lazy_names(__name__)
