import pytest

from impact_xval.model.graph.collision import solve_graph_collision
from impact_xval.model.graph.named import box


@pytest.fixture(scope="session", autouse=True)
def compiled_graphs(compiled_kernels):
    """Compile the kernel of graphs before the first test."""
    solve_graph_collision(box())
