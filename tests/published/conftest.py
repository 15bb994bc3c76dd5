from tests.model.conftest import compiled_model  # noqa: F401
