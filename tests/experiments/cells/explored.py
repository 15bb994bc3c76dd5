"""The explorer as a user has it: the command in a process of its own, and its page in a browser."""

import re
import signal
import subprocess
import sys
from contextlib import contextmanager

from tests.browser import opened

#: Milliseconds for the first answer: kernels may have to be compiled.
FIRST = 60_000

#: Moves a slider to values that it did not have, one after the other, each once the one before is drawn, and gives the
#: milliseconds from the slider's event to the frame after the new data.
_REDRAWS = """async ([key, moves]) => {
  const range = document.querySelector(`[data-of=${key}]`), answer = models.answer, times = [];
  const low = Number(range.min), high = Number(range.max);
  for (let i = 0; i < moves; i++) {
    range.value = low + (high - low) * (0.3 + 0.5 * (i + 0.5) / moves);
    const start = performance.now();
    await new Promise((resolve, reject) => {
      const late = setTimeout(() => reject(new Error("no answer within 20 s")), 20000);
      const drawn = () => {
        if (answer.data.query[0] !== query()) return;
        answer.change.disconnect(drawn);
        clearTimeout(late);
        requestAnimationFrame(resolve);
      };
      answer.change.connect(drawn);
      range.dispatchEvent(new Event("input", {bubbles: true}));
    });
    times.push(performance.now() - start);
  }
  return times;
}"""


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
                process.communicate(timeout=30)
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


def redraws(page, key, moves):
    """Milliseconds of so many redraws, by moving the slider of a parameter."""
    return page.evaluate(_REDRAWS, [key, moves])
