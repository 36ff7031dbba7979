"""Keeps the machine code of numba's functions so that a later process runs it without numba.

To import numba and to read its own cache takes longer than many questions do; llvmlite alone loads
the same code in a tenth of the time. The import of this module fails if numba is not installed.
Such a function creates no arrays, raises nothing, and returns whole numbers or nothing.
"""

from __future__ import annotations

import contextlib
import ctypes
import hashlib
import importlib.util
import json
import os
import sys
import tempfile
import threading
from functools import cached_property
from pathlib import Path
from types import FunctionType
from typing import Any, Callable, Dict, Iterator, Optional, Tuple

import numpy as np

_NUMBA = importlib.util.find_spec("numba")
if _NUMBA is None or _NUMBA.origin is None:
    raise ModuleNotFoundError("No module named 'numba'", name="numba")

import llvmlite  # noqa: E402  # numba has it
from llvmlite import binding  # noqa: E402

_VERSION = (_NUMBA.origin, os.path.getmtime(_NUMBA.origin), llvmlite.__version__, sys.version)

_LOCK = threading.Lock()

_SCALARS: Dict[type, Any] = {bool: ctypes.c_bool, int: ctypes.c_int64, float: ctypes.c_double}

_Found = Tuple[Any, int]
"""The function in memory, and how many numbers it returns: 0 is none, -1 one that is not in a
tuple."""


class KeptCode:
    """A function of arrays, whole numbers, floats, truth values, and tuples of them.

    :param function: what numba compiles; it may call other functions of this kind.
    """

    def __init__(self, function: Callable[..., Any]) -> None:
        self.__wrapped__ = function
        self.__doc__ = function.__doc__
        self._loaded: Dict[Tuple[Any, ...], _Found] = {}

    def __call__(self, *arguments: Any) -> Any:
        """Call the function. The first call in a process loads the code, or compiles it."""
        kinds = tuple(map(_kind, arguments))
        if kinds not in self._loaded:
            with _LOCK:
                if kinds not in self._loaded:
                    self._loaded[kinds] = self._load(kinds, arguments)
        code, count = self._loaded[kinds]
        result = (ctypes.c_int64 * max(count, 1))()
        status = code(result, ctypes.byref(ctypes.c_void_p()), *_flat(arguments))
        assert status in (0, -2), "compiled code returned %d" % status  # -2: it returns None
        return None if not count else result[0] if count < 0 else tuple(result)

    def _load(self, kinds: Tuple[Any, ...], arguments: Tuple[Any, ...]) -> _Found:
        file = self.__wrapped__.__code__.co_filename
        host = binding.get_host_cpu_name(), binding.get_host_cpu_features().flatten()
        wanted = _digest(_VERSION, host, Path(file).read_bytes())
        name = "%s.%s.%s-%s.o" % (
            Path(file).stem,
            self.__wrapped__.__name__,
            sys.implementation.cache_tag,
            _digest(kinds),
        )
        for folder in _folders(file):
            try:
                head, _, code = (folder / name).read_bytes().partition(b"\n")
                inside, count, *same = json.loads(head)
            except (OSError, ValueError):
                continue
            if same == [wanted, _digest(code)]:
                return _in_memory(inside, code, arguments), count
        inside, count, code = self._compiled(arguments)
        content = json.dumps([inside, count, wanted, _digest(code)]).encode() + b"\n" + code
        any(_written(folder, name, content) for folder in _folders(file))
        return _in_memory(inside, code, arguments), count

    def _compiled(self, arguments: Tuple[Any, ...]) -> Tuple[str, int, bytes]:
        """The name of the function in the code, how many numbers it returns, and the code."""
        from numba import typeof, types

        signature = tuple(map(typeof, arguments))
        self.dispatcher.compile(signature)
        description = self.dispatcher.overloads[signature].fndesc
        returned = description.restype
        count = len(returned) if isinstance(returned, types.BaseTuple) else -1
        name = description.llvm_func_name
        module = binding.parse_assembly(self.dispatcher.inspect_llvm(signature))
        taken = list(module.get_function(name).arguments)
        outside = [f.name for f in module.functions if f.is_declaration]
        # it must accept these arguments, and need nothing of Python or numba
        assert len(taken) == 2 + len(list(_flat(arguments))), "%s takes %s" % (name, taken)
        assert not [n for n in outside if n.startswith(("NRT", "numba", "Py"))], outside
        return name, 0 if returned == types.none else count, _machine().emit_object(module)

    @cached_property
    def dispatcher(self) -> Any:
        """The function as numba knows it."""
        from gspn_framework_package.analysis.compiling import compiled_part

        function = self.__wrapped__
        names = dict(function.__globals__)
        for name in function.__code__.co_names:
            if isinstance(names.get(name), KeptCode):
                names[name] = names[name].dispatcher
        plain = FunctionType(function.__code__, names, function.__name__)
        return compiled_part(plain, inserted=False)


def _digest(*parts: Any) -> str:
    return hashlib.sha256(repr(parts).encode()).hexdigest()[:24]


def _kind(argument: Any) -> Any:
    """Everything on which the machine code depends."""
    if isinstance(argument, np.ndarray):
        flags = argument.flags
        layout = "C" if flags.c_contiguous else "F" if flags.f_contiguous else "A"
        return argument.dtype.str, argument.ndim, layout, flags.writeable
    if isinstance(argument, tuple):
        return (type(argument).__name__, *map(_kind, argument))
    return type(argument).__name__


def _flat(arguments: Tuple[Any, ...]) -> Iterator[Any]:
    """The arguments as numba's functions take them: of an array, its owner (none), size, size of
    an item, address, shape and strides."""
    for argument in arguments:
        if isinstance(argument, np.ndarray):
            yield from (None, None)
            yield from map(ctypes.c_int64, (argument.size, argument.itemsize))
            yield ctypes.c_void_p(argument.ctypes.data)
            yield from map(ctypes.c_int64, argument.shape + argument.strides)
        elif isinstance(argument, tuple):
            yield from _flat(argument)
        elif isinstance(argument, np.uint64):
            yield ctypes.c_uint64(int(argument))
        else:
            plain = argument.item() if isinstance(argument, np.generic) else argument
            yield _SCALARS[type(plain)](plain)


def _machine() -> Any:
    with contextlib.suppress(RuntimeError):  # a newer llvmlite does this automatically
        binding.initialize()
    binding.initialize_native_target()
    binding.initialize_native_asmprinter()
    return binding.Target.from_default_triple().create_target_machine(
        cpu=binding.get_host_cpu_name(),
        features=binding.get_host_cpu_features().flatten(),
        opt=3,
        reloc="default",
        codemodel="jitdefault",
        jit=True,
    )


def _in_memory(name: str, code: bytes, arguments: Tuple[Any, ...]) -> Any:
    engine = binding.create_mcjit_compiler(binding.parse_assembly(""), _machine())
    engine.add_object_file(binding.ObjectFileRef.from_data(code))
    engine.finalize_object()
    kinds = [type(a) if a is not None else ctypes.c_void_p for a in _flat(arguments)]
    form = ctypes.CFUNCTYPE(ctypes.c_int32, ctypes.c_void_p, ctypes.c_void_p, *kinds)
    function: Any = form(engine.get_function_address(name))
    function.engine = engine  # the code lives as long as it does
    return function


def _folders(file: str) -> Iterator[Path]:
    """Where code may be kept: beside the source, or in the user's folder."""
    yield Path(file).parent / "__pycache__"
    home: Optional[str] = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    yield Path(str(home), "gspn_framework_package")


def _written(folder: Path, name: str, content: bytes) -> bool:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=str(folder), delete=False) as file:
            file.write(content)
        os.replace(file.name, str(folder / name))
    except OSError:
        return False
    return True
