"""A batch with a transform around it."""

from __future__ import annotations

import io
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt

from pearl_marl.base.arrays import Array, unpacked_arrays
from pearl_marl.base.deferral import uninterrupted
from pearl_marl.batch.step import BatchStep
from pearl_marl.errors import OrderError, SavedStateError
from pearl_marl.interfaces.batch import Batch, DeviceBatch
from pearl_marl.interfaces.world import Mask

from .transform import Transform

_FORMAT = b"PEARLWR1"


class TransformedBatch(Batch):
    """A batch, ``batch``, with a transform around it."""

    def __init__(self, batch: Batch, transform: Transform) -> None:
        self.batch, self.transform = batch, transform
        super().__init__(
            batch.batch_size,
            transform.observation_space,
            transform.action_rules,
            batch.autoreset,
            batch.slot_autoreset_mode,
            transform.world,
        )

    @property
    def innermost(self) -> DeviceBatch:
        """See :class:`Batch`."""
        return self.batch.innermost

    @property
    def present(self) -> Mask:
        """Which agents are there: the transform says."""
        return self.transform.present

    @property
    def in_episode(self) -> Mask:
        """See :class:`Batch`."""
        return self.batch.in_episode

    @property
    def action_masks(self) -> Array | None:
        """Which actions may be taken in the next step: the transform says."""
        return self.transform.action_masks

    @property
    def ready(self) -> bool:
        """Whether a step is possible: after the first reset of this wrapper, and until closed."""
        return self.transform.ready and self.batch.ready

    @uninterrupted
    def reset_batch(self, seed: int | None = None, mask: npt.ArrayLike | None = None) -> Array:
        """See :meth:`Batch.reset_batch`."""
        obs = self.batch.reset_batch(seed, mask)
        return self.transform.reset(obs, seed, None if mask is None else np.asarray(mask))

    @uninterrupted
    def step_rows(self, actions: npt.ArrayLike) -> BatchStep:
        """See :meth:`Batch.step_rows`."""
        if not self.batch.ready:
            self.batch.step_batch(actions)  # says why that is impossible
        return self.transform.step(actions)

    @uninterrupted
    def save_state(self) -> bytes:
        """Return all that the continuation depends on, what transforms remember included."""
        inner = self.batch.save_state()
        if not self.ready:
            raise OrderError("save_state() before reset(): call reset() of the outermost wrapper first")
        return _packed(inner, self.transform)

    @uninterrupted
    def load_state(self, blob: bytes) -> Array:
        """Continue from what :meth:`save_state` of a batch in transforms like these returned."""
        inner, remembered = _unpacked(blob, self.transform)
        obs = self.batch.load_state(inner)
        self.transform.restore(remembered)
        return self.transform.restored(obs)


def _packed(inner: bytes, transform: Transform) -> bytes:
    """Return the bytes of an environment and of the transform around it, as one."""
    file = io.BytesIO()
    arrays: dict[str, Any] = {"inner": np.frombuffer(inner, np.uint8), **transform.snapshot()}
    np.savez(file, **arrays)
    return _FORMAT + type(transform).__name__.encode() + b"\0" + file.getvalue()


def _unpacked(blob: bytes, transform: Transform) -> tuple[bytes, dict[str, Array]]:
    """Return the environment's bytes, and the snapshot for a transform like the one that was packed."""
    if not isinstance(blob, (bytes, bytearray, memoryview)):
        raise SavedStateError(f"a saved state is bytes, not {type(blob).__name__}")
    blob = bytes(blob)
    head, _, body = blob.partition(b"\0")
    name = type(transform).__name__.encode()
    if head != _FORMAT + name:
        raise SavedStateError(f"this is no saved state of an environment in a {name.decode()} wrapper")
    mine = transform.snapshot()

    def check(name: str, shape: tuple[int, ...], dtype: np.dtype[Any]) -> None:
        right = (
            (len(shape) == 1, np.uint8) if name == "inner" else (shape == mine[name].shape, mine[name].dtype)
        )
        if right != (True, dtype):
            raise SavedStateError(
                f"the saved state's {name!r} has shape {shape} and dtype {dtype}, which is not that of this "
                "wrapper"
            )

    try:
        saved = unpacked_arrays(body, {name: partial(check, name) for name in ("inner", *mine)})
    except SavedStateError:
        raise
    except ValueError as error:
        raise SavedStateError(f"the saved state is damaged: {error}") from None
    inner = saved.pop("inner").tobytes()
    if (wrong := transform.wrong(saved)) is not None:
        raise SavedStateError(f"the saved state's {wrong!r} has numbers that no step of this wrapper leaves")
    return inner, saved
