from tests.model.conftest import compiled_kernels  # noqa: F401
