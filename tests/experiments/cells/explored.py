"""The explorer as a user has it: the command in a process of its own, and its page in a browser."""

import re
import signal
import subprocess
import sys
from contextlib import contextmanager

from tests.browser import opened

#: Milliseconds after which it hangs: kernels may have to be compiled.
FIRST = 300_000


@contextmanager
def served(*options):
    """Serve the explorer at a free port; gives the process, interrupted in the end, and its address."""
    command = [sys.executable, "-m", "impact_xval", "explore", "--no-browser", "--port", "0", *options]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, bufsize=1)
    try:
        line = process.stdout.readline()
        found = re.match(r"(http://\S+:\d+/) ", line)
        assert found, (line, process.stderr.read() if process.poll() is not None else "")
        yield process, found[1]
    finally:
        if process.poll() is None:
            process.send_signal(signal.SIGINT)
            try:
                process.communicate(timeout=300)
            except subprocess.TimeoutExpired:
                process.kill()
                raise


@contextmanager
def explored(query="", **look):
    """Open the page of a query; gives it once its cell is drawn."""
    with served() as (_, address), opened(address + query, offline=False, **look) as page:
        wait_for(page, "models !== null && models.answer.data.query[0] === query()")
        yield page


def wait_for(page, what, milliseconds=FIRST):
    """Wait until an expression of JavaScript holds."""
    page.wait_for_function(f"() => typeof models !== 'undefined' && ({what})", timeout=milliseconds)
