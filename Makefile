# Two commands for users: `make demo` and `make test`. Each sets up everything it needs in .venv.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
# Without bytecode: of what is installed a small part is ever imported, and that is compiled then.
INSTALL := PIP_DISABLE_PIP_VERSION_CHECK=1 PIP_CONSTRAINT=constraints.txt \
  $(BIN)/python -m pip install --quiet --no-compile
DEMO_OUT ?= demo-output
# Every process of a run would compile all that it imports anew, 0.7 s of a fit's 2.4 s; many images forbid the cache.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: demo test test-under-load lint bench docs clean

demo: $(VENV)/.installed
	$(BIN)/iiwa-ident demo --out $(DEMO_OUT)

# Freed memory is kept: to give it back and to fetch it anew, page by page, is up to a tenth of what a diagnosis takes.
KEEP_MEMORY := MALLOC_MMAP_THRESHOLD_=33554432 MALLOC_TRIM_THRESHOLD_=536870912

# Three at a time on two cores, since the tests with processes wait for most of theirs; in the order of the folders, since
# those that begin last would be the few that take minutes.
test: $(VENV)/.installed-test
	$(BIN)/ruff check .
	$(BIN)/mypy -n 2
	OPENBLAS_NUM_THREADS=1 $(KEEP_MEMORY) $(BIN)/pytest -n 3 --dist loadfile --no-loadscope-reorder

lint: $(VENV)/.installed-test
	$(BIN)/ruff check .
	$(BIN)/mypy -n 2

# The tests with processes and sockets, ten times beside two busy loops: none of them may grade the machine.
test-under-load: $(VENV)/.installed-test
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m benchmarks.tests_under_load

# Most take minutes; endurance (30), prove (600 cases) and estimators have a short form here. identification_speed needs
# FIGAROH: pip install -e '.[bench]'.
bench: $(VENV)/.installed-test
	for benchmark in loop recorder stops pipelines real_recordings feasibility absorbed \
	  "excitation --all-targets" "endurance --minutes 3" "estimators --draws 200" "prove --cases 200"; do \
	  set -- $$benchmark; script=$$1; shift; echo "== $$script"; \
	  OPENBLAS_NUM_THREADS=1 $(BIN)/python -m benchmarks.$$script "$$@" || exit 1; done

# The reference from the docstrings, as pages in build/reference.
docs: $(VENV)/.installed
	$(INSTALL) --editable '.[docs]'
	$(BIN)/pdoc --output-directory build/reference identification.interface identification.robots \
	  identification.recordings identification.recording_fit identification.validation identification.excitation \
	  identification.mismatch.findings fri_client safety daemon.api
	@echo "Open build/reference/index.html"

clean:
	rm -rf $(VENV) $(DEMO_OUT)* build dist *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis

$(VENV)/.created:
	$(PYTHON) -c 'import sys; sys.exit("Python 3.11 or newer is needed; set PYTHON=... to one." if sys.version_info < (3, 11) else 0)'
	$(PYTHON) -m venv $(VENV)
	touch $@

$(VENV)/.installed: $(VENV)/.created pyproject.toml constraints.txt
	$(INSTALL) --editable .
	touch $@

$(VENV)/.installed-test: $(VENV)/.created pyproject.toml constraints.txt
	$(INSTALL) --editable '.[test]'
	touch $(VENV)/.installed $@
