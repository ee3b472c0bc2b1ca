# Copyright (C) 2026 the dolfinx_feti authors
#
# SPDX-License-Identifier: LGPL-3.0-or-later
#
# Each target does all of its own set-up: scripts/with-fenicsx finds FEniCSx or makes it. Variables:
#   NP=2           processes for demo and bench (default: 2, or 1 on a single core)
#   ARGS="…"       further arguments of the demo, the benchmark, or pytest
#   FENICSX_SUITE=sid make …   the newest dolfinx

# nproc takes OpenMP's threads, of which a process is to have one, for the number of cores.
cores := $(shell env -u OMP_NUM_THREADS -u OMP_THREAD_LIMIT nproc 2>/dev/null || echo 1)
NP ?= $(if $(filter-out 1,$(cores)),2,1)
ARGS ?=

with := scripts/with-fenicsx
python := $(if $(filter-out 1,$(NP)),env OMP_NUM_THREADS=1 mpirun -n $(NP) )python3
threaded := env OMP_NUM_THREADS=$(NP) python3
compare := -m benchmarks.compare --json build/speed.json --rounds 5
direct := feti,mumps,cholmod,pardiso
iterative := feti,mumps,gamg,gamg-elasticity,hypre-elasticity
compressible := feti,feti-dual,mumps,gamg,gamg-elasticity,hypre-elasticity,bddc
comma := ,
# What is built, compared with dense matrices and a direct solver: K K⁺ K = K and S of a subdomain, on one process;
# B u = b, P² = P, F, M and the primal form, on two.
identities_1 := tests/torn tests/feti/subdomain tests/feti/test_against_direct.py
identities_2 := $(filter-out %/subdomain/ %/regularity/,$(wildcard tests/feti/[a-z]*/))
shell_scripts := scripts/with-fenicsx scripts/debian-tree .ci/run

.PHONY: help demo test sanitize figures bench bench-compare bench-compressible bench-linear bench-nonlinear bench-scaling bench-verification lint check docs clean

help: ## what can be made
	@awk -F ':.*## ' '/^[a-z-]+( build.*)?:.*## / { sub(/ build.*/, "", $$1); printf "  make %-16s %s\n", $$1, $$2 }' $(MAKEFILE_LIST)
	@echo '  with NP=2 (processes), ARGS="…" (further arguments), FENICSX_SUITE=sid (newest dolfinx)'

demo: ## inflate the artery's wall, next to a direct solver; pictures in output/artery/
	$(with) $(python) demos/demo_artery.py $(ARGS)

test: ## the whole suite on 1, 2 and 3 processes, and some of it on 4 and 8
	$(with) python3 scripts/run_tests.py $(ARGS)

sanitize: flags = -O1 -g -fno-omit-frame-pointer -fsanitize=address,undefined -fno-sanitize-recover=all
sanitize: stopping = ASAN_OPTIONS=detect_leaks=0 UBSAN_OPTIONS=print_stacktrace=1
sanitize: runtimes = $$(gcc -print-file-name=libasan.so):$$(gcc -print-file-name=libubsan.so):$$(gcc -print-file-name=libstdc++.so)
sanitize: ## the tests that call the package's C code, with AddressSanitizer and UndefinedBehaviorSanitizer
	$(with) sh -c 'DOLFINX_FETI_CFLAGS="$(flags)" LD_PRELOAD="$(runtimes)" $(stopping) OMP_NUM_THREADS=1 \
	  XDG_CONFIG_HOME=tests/config python3 -m pytest -q -p no:cacheprovider tests/torn tests/runtime \
	  tests/fem/test_condensation.py tests/fem/test_cell_kernels.py tests/fem/test_assembly.py tests/feti/interface tests/feti/subdomain $(ARGS)'

bench: bench-linear bench-nonlinear bench-scaling bench-compare bench-compressible bench-verification ## all benchmarks; what is finished is not run again

bench-linear: ## the paper's linear study and what goes beyond it; report in build/results/
	$(with) $(python) -m benchmarks.cube --json build/linear.json $(ARGS)
	$(with) python3 -m benchmarks.cube --json build/linear.json --page build/results

# Bodies and sizes of a first step, of loaded states, and of paths; the greatest κ is for direct solvers.
bench-compare: ## FETI and other solvers on the same matrices, time and memory; report in build/results/
	for body in "tube --dofs 60000,184000,411000" "vessel --dofs 71000,199000" "block --dofs 28000,73000,207000"; do \
	  $(with) $(python) $(compare) --geometry $$body --kappa 10,1000 --solvers $(iterative) $(ARGS) && \
	  $(with) $(python) $(compare) --geometry $$body --kappa 100000 --solvers feti,mumps $(ARGS) && \
	  $(with) $(threaded) $(compare) --geometry $$body --kappa 10,1000,100000 --solvers $(direct) $(ARGS) || exit; \
	done
	for state in "vessel --dofs 71000 --loaded 10" "tube --dofs 60000 --loaded 100" "tube --degree 1 --dofs 60000" \
	  "vessel --degree 1 --dofs 71000" "vessel --dofs 71000 --path 10" "tube --dofs 60000 --path 100"; do \
	  $(with) $(python) $(compare) --geometry $$state --solvers feti,mumps $(ARGS) && \
	  $(with) $(threaded) $(compare) --geometry $$state --solvers feti,mumps $(ARGS) || exit; \
	done
	for number in 16 512 1024; do $(with) $(python) $(compare) --dofs 184000 --subdomains $$number --solvers feti $(ARGS) || exit; done
	for body in "tube --dofs 8000,30000,80000" "vessel --dofs 71430" "pillar --dofs 8000,30000,80000" \
	  "cube --degree 1 --dofs 8000,30000,80000" "cube --dofs 8000,30000,80000" "square --degree 1 --dofs 30000" \
	  "heat --degree 1 --dofs 30000"; do \
	  $(with) env OMP_NUM_THREADS=1 python3 $(compare) --geometry $$body --per 500,1000,1500,2000,3000,4500,7000 $(ARGS) || exit; \
	done
	$(with) python3 -m benchmarks.compare --json build/speed.json --page build/results

# Both formulations, also where the dual one takes thousands of iterations, which is why there are three rounds.
bench-compressible: ## both formulations of FETI and other solvers on compressible bodies; 10 minutes; report in build/results/
	for body in cube plate-20 plate-100 plate-1000 inclusions-1e4 inclusions-1e8; do \
	  $(with) $(python) -m benchmarks.compare --json build/speed.json --rounds 3 --geometry $$body --degree 1 --dofs 30000 \
	    --solvers $(compressible) $(ARGS) || exit; \
	done
	$(with) python3 -m benchmarks.compare --json build/speed.json --page build/results

bench-nonlinear: ## iterations and seconds per Newton step, tube and vessel; report in build/results/
	$(with) env OMP_NUM_THREADS=1 python3 -m benchmarks.nonlinear --json build/nonlinear.json $(ARGS)
	$(with) python3 -m benchmarks.nonlinear --json build/nonlinear.json --page build/results

bench-scaling: ## strong scaling on one and two processes, counts on up to 64; report in build/results/
	$(with) python3 -m benchmarks.scaling --size 0.8 --processes $(if $(filter-out 1,$(NP)),1$(comma)$(NP),1) --json build/scaling.json $(ARGS)
	$(with) python3 -m benchmarks.scaling --json build/scaling.json --page build/results

bench-verification: ## published numbers, the tube in closed form, inf-sup constants, random walls; report in build/results/
	$(with) env OMP_NUM_THREADS=1 python3 -m benchmarks.verification --part published,inf-sup --json build/verification.json
	for element in p2-p0 q2-p1d p2b-p1d; do for size in 0.09 0.045; do \
	  $(with) env OMP_NUM_THREADS=1 python3 -m benchmarks.verification --part tube --pressures 300 --kappa 1e5 --element $$element \
	    --size $$size --subdomains 4 --json build/verification.json $(ARGS) || exit; \
	done; done
	$(with) env OMP_NUM_THREADS=1 python3 -m benchmarks.random_walls --json build/random_walls.json
	$(with) env OMP_NUM_THREADS=1 python3 -m benchmarks.distorted_cells --json build/distorted_cells.json
	$(with) python3 -m benchmarks.verification --json build/verification.json --page build/results
	$(with) python3 -m benchmarks.random_walls --json build/random_walls.json --page build/results
	$(with) python3 -m benchmarks.distorted_cells --json build/distorted_cells.json --page build/results

figures: direct = --type classical --subdomains 1
figures: files = --json build/loading.json --checkpoint build/loading
figures: ## both variants up to 300 mmHg on tube and vessel, and the paper's figures of it; build/results/
	$(with) $(python) -m benchmarks.load_stepping --geometry tube --size 0.3 --degree 2 $(files)/tube $(ARGS)
	$(with) $(python) -m benchmarks.load_stepping --size 1.2 --first 25 $(files)/p1 $(ARGS)
	$(with) $(python) -m benchmarks.load_stepping --size 1.6 --degree 2 $(files)/p2 $(ARGS)
	$(with) python3 -m benchmarks.load_stepping --size 1.2 --first 25 $(direct) $(files)/p1-direct
	$(with) python3 -m benchmarks.load_stepping --size 1.6 $(direct) $(files)/p1-coarse-direct
	$(with) python3 -m benchmarks.load_stepping --size 1.6 --degree 2 $(direct) $(files)/p2-direct
	$(with) python3 -m benchmarks.load_stepping --json build/loading.json --page build/results

# Of Python files, texts and shell scripts; .pre-commit-config.yaml has the same tools.
define lint_files
$(if $(1),$(with) ruff check $(1))
$(if $(1),$(with) ruff format --check $(1))
$(if $(1),$(with) mypy dolfinx_feti)
$(if $(2),$(with) codespell $(2))
$(if $(3),$(with) shellcheck $(3))
endef

lint: ## style, types, spelling
	$(call lint_files,.,.,$(shell_scripts))

changed = $(sort $(shell git diff --name-only --diff-filter=d $$(git merge-base HEAD main 2>/dev/null || echo HEAD); \
  git ls-files --others --exclude-standard))

check: ## lint of what has changed since main, and the tests of identities; under a minute
	$(call lint_files,$(filter %.py,$(changed)),$(filter %.py %.md %.toml %.c,$(changed)),$(filter $(shell_scripts),$(changed)))
	$(with) env DOLFINX_FETI_TEST_PROCESSES=1 python3 scripts/run_tests.py $(identities_1) $(ARGS)
	$(with) env DOLFINX_FETI_TEST_PROCESSES=2 python3 scripts/run_tests.py $(identities_2) $(ARGS)

docs: export FENICSX_PACKAGES = docs
docs: ## the site in build/docs/, with every demo executed, looked at in a browser; some 7 minutes of CPU time (AMD EPYC)
	$(with) python3 scripts/demo_pages.py
	$(with) python3 scripts/rooms.py --modules
	rm -rf build/docs # pages of files that are gone
	$(with) python3 -m sphinx -W --keep-going -q docs build/docs
	$(with) python3 scripts/look_at_site.py build/docs

clean: ## remove results and caches, not the Debian trees
	rm -rf build docs/demos docs/modules.md output dist *.egg-info .mypy_cache .pytest_cache .ruff_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
