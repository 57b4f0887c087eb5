"""From an environment that somebody else wrote to one of this platform: ``pearl new NAME --from package:Class``.

:mod:`~pearl_marl.porting.originals` wraps it, :mod:`~pearl_marl.porting.finite` makes tables of it where it is
finite, :mod:`~pearl_marl.porting.attributes` finds what its state is where it is not,
:mod:`~pearl_marl.porting.package` writes the package, and :mod:`~pearl_marl.porting.against` compares the two.
"""

from pearl_marl.porting.originals import Original
from pearl_marl.porting.port import Port, as_words, like
from pearl_marl.porting.tables import first_wrong_transition

__all__ = ["Original", "Port", "as_words", "first_wrong_transition", "like"]
