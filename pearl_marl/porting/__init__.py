"""From somebody else's environment to one of this platform: ``pearl new NAME --from package:Class``.

:mod:`~pearl_marl.porting.originals` wraps it. Where it is finite, :mod:`~pearl_marl.porting.finite` finds all
that it does and :mod:`~pearl_marl.porting.tables` makes tables of it; where it is not,
:mod:`~pearl_marl.porting.attributes` finds what its state is. :mod:`~pearl_marl.porting.package` and
:mod:`~pearl_marl.porting.skeleton` write the package, :mod:`~pearl_marl.porting.port` compares its parts with
the original, and :mod:`~pearl_marl.porting.against` the whole.
"""

from pearl_marl.porting.originals import Original
from pearl_marl.porting.port import Port, as_numbers, like
from pearl_marl.porting.tables import first_wrong_transition

__all__ = ["Original", "Port", "as_numbers", "first_wrong_transition", "like"]
