# Thin wrappers: `make demo` and `make test` need Python 3.11, pip, git and make, and nothing else.
PYTHON ?= $(shell command -v python3.11 || command -v python3)
CORES ?= all
VENV := .venv
BIN := $(VENV)/bin
# Snakemake waits for ever for a core of none.
ifeq ($(filter-out 0,$(CORES)),)
$(error CORES is '$(CORES)': a positive number, or all)
endif
SNAKEMAKE := $(BIN)/snakemake --profile workflow/profiles/local --cores $(CORES)
# A path comes to the shell as a variable of its own, so that nothing in its name is run.
override export IMAGE := $(value IMAGE)
BEREA ?=
export BEREA KETTON
CASES := stereology virtual_spheres virtual_spheres_deep berea xct cv_sweep

.PHONY: setup demo test lint format docs cases validation sweep accuracy accuracy-presets thin-section engines consolidated ketton report bench-costs bench-stereology bench-segmentation bench-engines bench-creep bench-packing bench-decomposition bench-structure bench-overhead bench-needs bench-network bench-permeability paper-scale hard-cases faults verify help clean

demo: $(VENV)/.ready  ## the embedded demo, to results/summary.csv and results/report.html
	$(SNAKEMAKE)

setup: $(VENV)/.ready  ## the environment alone; every other target makes it, too

test: $(VENV)/.ready  ## the whole test suite
	$(BIN)/python -m pytest -n 2 --dist loadgroup --no-loadscope-reorder tests

# pip installs into the environment from outside, so it needs neither ensurepip nor a pip of its own.
$(VENV)/.ready: requirements.lock pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info[:2] != (3, 11))' \
		|| { echo "Python 3.11 is needed, $(PYTHON) is another; say make PYTHON=/path/to/python3.11"; exit 1; }
	$(PYTHON) -m venv --without-pip $(VENV)
	$(PYTHON) -m pip --python $(BIN)/python install --disable-pip-version-check --no-deps -r requirements.lock
	$(PYTHON) -m pip --python $(BIN)/python install --disable-pip-version-check --no-deps --no-build-isolation -q -e .
	@touch $@

cases: $(addprefix case-,$(CASES)) $(if $(IMAGE),thin-section)  ## the validation cases (a day on two cores; resumes where it stopped), then the page

# What is finished goes into results/validation.html, also where the case stops half-way.
case-%: $(VENV)/.ready  ## one case: make case-stereology; fewer twins: make case-stereology REALIZATIONS=1
	@test -f "config/cases/$*.yaml" || { echo "there is no case $*: $(CASES)"; exit 1; }
	$(SNAKEMAKE) --keep-going --configfile config/cases/$*.yaml \
		$(if $(REALIZATIONS)$(and $(filter berea,$*),$(BEREA)),--config) \
		$(if $(REALIZATIONS),realizations=$(REALIZATIONS)) \
		$(if $(and $(filter berea,$*),$(BEREA)),"data={\"berea\": {\"source\": \"$$BEREA\"}}") \
		-- case; status=$$?; $(VALIDATION) && exit $$status

VALIDATION = $(SNAKEMAKE) --configfile config/cases/stereology.yaml -- validation

validation: $(VENV)/.ready  ## table and page of whatever of the cases is finished
	$(VALIDATION)

thin-section: $(VENV)/.ready  ## a real section: make thin-section IMAGE=path/to/miocene_20_2_instances.npz
	@test -n "$$IMAGE" || { echo "say which image: make thin-section IMAGE=path/to/instances.npz"; exit 1; }
	$(SNAKEMAKE) --configfile config/cases/thin_section.yaml \
		--config "samples={thin_section: {image: '$$IMAGE'}}"; status=$$?; $(VALIDATION) && exit $$status

# What is measured goes into the table and the figure, also where the sweep stops half-way.
ACCURACY = $(SNAKEMAKE) --configfile config/cases/accuracy.yaml

accuracy: $(VENV)/.ready  ## error against cost of every setting; resumes where it stopped; more of them: REALIZATIONS=5
	$(ACCURACY) --keep-going $(if $(REALIZATIONS),--config realizations=$(REALIZATIONS)) -- accuracy_sweep; \
		status=$$?; $(ACCURACY) -- accuracy && exit $$status

accuracy-presets: accuracy  ## the same, and what it says of the presets becomes what `accuracy: {metric, tolerance}` goes by
	cp results/accuracy/presets.csv src/grainfall/presets.csv

sweep: $(VENV)/.ready  ## an example of a sweep: config/sweep.tsv in, results/sweep.csv out
	$(SNAKEMAKE) --configfile config/cases/sweep.yaml -- results/sweep.csv

verify: $(VENV)/.ready  ## is everything behind the results still as it was? Says what changed; status 1 if anything did
	$(BIN)/grainfall verify

consolidated: $(VENV)/.ready  ## a rock as dense as Fontainebleau sandstone: five truths, one twin of each
	$(SNAKEMAKE) --configfile config/cases/consolidated.yaml

ketton: $(VENV)/.ready  ## a real limestone, one twin of each of three slices; your own copy: make ketton KETTON=path/to/ketton.tif
	$(SNAKEMAKE) --configfile config/cases/ketton.yaml $(if $(KETTON),--config "data={\"ketton\": {\"source\": \"$$KETTON\"}}")

engines: $(VENV)/.ready  ## PhysX and Bullet side by side, five paired realizations
	$(SNAKEMAKE) --configfile config/cases/engines.yaml

report: $(VENV)/.ready  ## Snakemake's own report of the finished demo
	$(BIN)/snakemake --report results/snakemake-report.html

lint: $(VENV)/.ready  ## ruff, snakefmt, snakemake --lint, import-linter
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/snakefmt --check Snakefile workflow
	$(BIN)/snakemake --lint
	$(BIN)/lint-imports

format: $(VENV)/.ready  ## all files in the house's format
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .
	$(BIN)/snakefmt Snakefile workflow

docs: $(VENV)/.ready  ## the documentation site, to results/docs; a warning is an error
	$(BIN)/sphinx-build -W --keep-going -q -b html docs results/docs

bench-costs: $(VENV)/.ready  ## what twins cost, the table behind the expectations of `grainfall new`
	$(BIN)/python tests/benchmarks/costs.py

bench-stereology: $(VENV)/.ready
	$(BIN)/python tests/benchmarks/stereology.py --out results/benchmarks/stereology.csv
	$(BIN)/python tests/benchmarks/grain_shapes.py --out results/benchmarks/grain_shapes.csv

bench-segmentation: $(VENV)/.ready
	$(BIN)/python tests/benchmarks/segmentation.py --out results/benchmarks/segmentation.csv

bench-engines: $(VENV)/.ready  ## Bullet, and the settings of the paper one by one, against the default
	$(BIN)/python tests/benchmarks/engines.py --out results/benchmarks/engines.csv

bench-creep: $(VENV)/.ready
	$(BIN)/python tests/benchmarks/creep.py --seeds 5 --out results/benchmarks/creep.csv

bench-packing: $(VENV)/.ready  ## hours; resumes where it stopped
	$(BIN)/python tests/benchmarks/packing.py --out results/benchmarks/packing_physics.csv
	$(BIN)/python tests/benchmarks/packing_speed.py --out results/benchmarks/packing_speed.csv

bench-decomposition: $(VENV)/.ready  ## a section's grains too: make bench-decomposition IMAGE=path/to/instances.npz
	$(BIN)/python tests/benchmarks/decomposition.py $${IMAGE:+--section "$$IMAGE"} \
		--out results/benchmarks/decomposition.csv

bench-structure: $(VENV)/.ready  ## where twins of a finished case differ from their truths: make bench-structure CASE=virtual_spheres
	$(BIN)/python tests/benchmarks/pore_structure.py $(or $(CASE),virtual_spheres) $(if $(VARIANT),--variant $(VARIANT)) \
		--out results/benchmarks/pore_structure.csv

bench-overhead: $(VENV)/.ready  ## what a job costs beside its work
	$(BIN)/python tests/benchmarks/job_overhead.py

bench-needs: $(VENV)/.ready  ## what jobs need, from finished runs: make bench-needs RUNS="a b"; CHECK=1 compares only
	$(BIN)/python tests/benchmarks/needs.py $(RUNS) $(if $(CHECK),--check)

bench-network: $(VENV)/.ready  ## time, memory and topology of network extraction
	$(BIN)/python tests/benchmarks/network.py --out results/benchmarks/network_speed.csv

bench-permeability: $(VENV)/.ready  ## K against published values; of your own rock: make bench-permeability VOLUME=rock.tif VOXEL=2.5
	OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(BIN)/python tests/benchmarks/permeability.py --out results/benchmarks/permeability.csv \
		$(if $(VOLUME),--samples --volume "$(VOLUME)" $(if $(VOXEL),--voxel $(VOXEL)) $(if $(PORE),--pore $(PORE)) $(if $(EDGE),--edge $(EDGE)))

paper-scale: $(VENV)/.ready  ## 1000^3 voxels from section to report, and smaller ones; some: make paper-scale EDGES="125 250"
	$(BIN)/python tests/benchmarks/paper_scale.py $(if $(EDGES),--edges $(EDGES)) $(if $(filter-out all,$(CORES)),--cores $(CORES))

hard-cases: $(VENV)/.ready  ## hard scenes in both engines against the verdicts written down before; hours; resumes where it stopped
	$(BIN)/python tests/benchmarks/hard_cases.py

faults: $(VENV)/.ready  ## an hour: 50 kills, 2,000 malformed inputs, 50 more on the command line; kills resume where they stopped
	$(BIN)/python tests/faults/fuzz.py --cases 2000 --command-line 50
	$(BIN)/python tests/faults/kills.py --kills 50 --out results/benchmarks/faults.csv

help:  ## this list
	@sed -n 's/^\([a-z%-]*\):.*## /\1\t/p' $(MAKEFILE_LIST) | expand -t 22

clean:  ## results and caches, not the environment
	rm -rf .snakemake $(filter-out results/README.md,$(wildcard results/*))
