"""The file of a policy in integers: the tensors of its network, and what they are of. Nothing in it runs.

It is a ``safetensors`` file with a checksum, like that of a trained policy
(:mod:`pearl_marl.policies.policy_file`).
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from pearl_marl.base.arrays import Array
from pearl_marl.envs import registered_spec
from pearl_marl.errors import ArgumentError, brief, one_line
from pearl_marl.policies.integer_network import (
    AgentNetworks,
    Dense,
    Head,
    IntegerNetwork,
    Levels,
    Patches,
    Rows,
    Scaling,
)
from pearl_marl.spec import EnvSpec

KIND = "integers"
"""What such a file says that its policy is."""

NAME = "integers.safetensors"
"""What such a file is called in a run folder."""

_INPUTS: dict[str, tuple[type[Any], dict[str, type[Any]]]] = {
    "scaling": (Scaling, {"offset": np.int64, "multiplier": np.int64, "shift": np.int64}),
    "rows": (Rows, {"first": np.int64, "factors": np.int64, "table": np.int32}),
    "patches": (Patches, {"weights": np.int16, "bias": np.int32}),
}
_LAYER = {"weights": np.int16, "bias": np.int32, "activation": np.int16}
_HEADS: dict[str, tuple[type[Any], dict[str, type[Any]]]] = {
    "actions": (Head, {"weights": np.int32}),
    "levels": (Levels, {"multiplier": np.int64, "offset": np.int64, "low": np.int64, "high": np.int64}),
}
"""The kinds of the parts of a network, and the dtypes of their tensors."""


def save(policy: IntegerNetwork | AgentNetworks, path: Path) -> None:
    """Write what :func:`load_policy` reads."""
    import torch

    from pearl_marl.policies import policy_file

    about: dict[str, Any] = {
        "environment": policy.spec.name,
        "options": dict(policy.spec.options),
        "kind": KIND,
    }
    tensors: dict[str, Array] = {}
    if isinstance(policy, AgentNetworks):
        about["agents"] = []
        for k, network in enumerate(policy.networks):
            described, own = _written(network)
            about["agents"].append(described)
            tensors.update({f"agent.{k}.{name}": array for name, array in own.items()})
    else:
        described, tensors = _written(policy)
        about.update(described)
    policy_file.write(
        path, about, {name: torch.from_numpy(np.ascontiguousarray(of)) for name, of in tensors.items()}
    )


def _written(network: IntegerNetwork) -> tuple[dict[str, Any], dict[str, Array]]:
    """Return what is written of a network: its description, and its tensors."""
    tensors: dict[str, Array] = {"indicator": network.indicator.astype(np.int32)}
    about: dict[str, Any] = {"layers": len(network.layers)}

    def put(name: str, part: Any, dtypes: dict[str, Any]) -> dict[str, Any]:
        """Take a part's tensors; return its other fields."""
        fields = part._asdict()
        tensors.update({f"{name}.{k}": np.asarray(fields.pop(k)).astype(kind) for k, kind in dtypes.items()})
        return {k: list(v) if isinstance(v, tuple) else int(v) for k, v in fields.items()}

    for name, kinds, part in (("inputs", _INPUTS, network.inputs), ("head", _HEADS, network.head)):
        kind, dtypes = next((k, of) for k, (made, of) in kinds.items() if isinstance(part, made))
        about[name] = {"kind": kind, **put(name, part, dtypes)}
    for k, layer in enumerate(network.layers):
        about[f"layer.{k}"] = put(f"layer.{k}", layer, _LAYER)
    return about, tensors


def load_policy(path: str | Path) -> IntegerNetwork | AgentNetworks:
    """Read a policy that devices can run, for ``rollout()``: a file, or the one in a run folder.

    ``pearl quantize`` makes such files of trained policies.

    Raises
    ------
    ArgumentError
        There is none, or it is damaged or of another kind.
    """
    if not isinstance(path, (str, Path)):
        raise ArgumentError(f"path is {path!r}; it must be that of a file or of a run folder")
    path = Path(path)
    file = path / NAME if path.is_dir() else path
    if path.is_dir() and not file.exists():
        raise ArgumentError(f"{path} has no policy in integers: make one with `pearl quantize {path}`")
    try:
        from pearl_marl.policies import policy_file  # which takes torch
    except ModuleNotFoundError as error:
        raise ArgumentError(f"{file} takes {error.name}: pip install '.[train]'") from None
    about, tensors = policy_file.read(file)
    if isinstance(about, dict) and about.get("kind") != KIND:
        raise ArgumentError(f"{file} is no policy in integers: make one of it with `pearl quantize {file}`")
    try:
        return _policy(about, {name: tensor.numpy() for name, tensor in tensors.items()})
    except ArgumentError as error:
        raise ArgumentError(f"{file} is damaged, or of another version: {one_line(error)}") from None


def _policy(about: Any, tensors: dict[str, Array]) -> IntegerNetwork | AgentNetworks:
    if not isinstance(about, dict):
        raise ArgumentError("its metadata say nothing of its policy")
    name, options = _of(about, "environment", str), _of(about, "options", dict)
    spec = registered_spec(name).with_options(**options)
    if "agents" not in about:
        return _network(spec, about, tensors)
    descriptions = _of(about, "agents", list)
    if not descriptions or not all(isinstance(described, dict) for described in descriptions):
        raise ArgumentError("its metadata must describe each agent's network")
    own: list[dict[str, Array]] = [{} for _ in descriptions]
    for key, tensor in tensors.items():
        place = next((k for k in range(len(own)) if key.startswith(f"agent.{k}.")), None)
        if place is None:
            raise ArgumentError(f"it has a tensor {brief(key)}, which is of none of its agents")
        own[place][key.removeprefix(f"agent.{place}.")] = tensor
    return AgentNetworks(tuple(_network(spec, *each) for each in zip(descriptions, own, strict=True)))


def _network(spec: EnvSpec, about: dict[str, Any], tensors: dict[str, Array]) -> IntegerNetwork:
    layers = _of(about, "layers", int)
    wanted = {"indicator"}

    def read(where: str, made: type[Any], dtypes: dict[str, Any], fields: dict[str, Any]) -> Any:
        wanted.update(f"{where}.{k}" for k in dtypes)
        arrays = {k: _tensor(tensors, f"{where}.{k}", np.dtype(kind)) for k, kind in dtypes.items()}
        others = {k: tuple(v) if isinstance(v, list) else v for k, v in fields.items() if k != "kind"}
        for k, value in others.items():
            numbers = value if isinstance(value, tuple) else (value,)
            if not all(type(number) is int and 0 <= number < 1 << 31 for number in numbers):
                raise ArgumentError(f"{where} has the {k} {brief(value)}")
        if made is Patches:  # older files do not have it
            others.setdefault("element_shift", 0)
        if {*arrays, *others} != {*made._fields}:
            raise ArgumentError(f"{where} has the fields {', '.join(sorted({*arrays, *others}))}")
        return made(**arrays, **others)

    def one_of(where: str, kinds: dict[str, tuple[type[Any], dict[str, Any]]]) -> Any:
        fields = _of(about, where, dict)
        if fields.get("kind") not in kinds:
            raise ArgumentError(f"its {where} have the kind {brief(fields.get('kind'))}")
        return read(where, *kinds[fields["kind"]], fields)

    if not 1 <= layers <= len(tensors):
        raise ArgumentError(f"it has {layers} layers, and {len(tensors)} tensors")
    network = IntegerNetwork(
        spec,
        one_of("inputs", _INPUTS),
        _tensor(tensors, "indicator", np.dtype(np.int32)),
        tuple(read(f"layer.{k}", Dense, _LAYER, _of(about, f"layer.{k}", dict)) for k in range(layers)),
        one_of("head", _HEADS),
    )
    if extra := tensors.keys() - wanted:
        raise ArgumentError(f"it has a tensor {brief(min(extra))}, which is of no part of its network")
    return network


def _of(about: dict[str, Any], name: str, kind: type[Any]) -> Any:
    if type(about.get(name)) is not kind:
        raise ArgumentError(f"its policy has the {name} {brief(about.get(name))}")
    return about[name]


def _tensor(tensors: dict[str, Array], name: str, dtype: np.dtype[Any]) -> Array:
    found = tensors.get(name)
    if found is None or found.dtype != dtype:
        what = "nothing" if found is None else found.dtype
        raise ArgumentError(f"{name} is {what}, not {dtype}")
    return found
