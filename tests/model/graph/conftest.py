import pytest

from impact_xval.model.graph.named import box
from impact_xval.model.graph.solving import solve_graph_collision


@pytest.fixture(scope="session", autouse=True)
def compiled_graphs(compiled_kernels):
    """Compile the kernel of graphs before the first test."""
    solve_graph_collision(box())
