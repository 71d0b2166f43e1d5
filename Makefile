# The commands of the project. Each installs what is missing first; `make setup` does that alone.
SHELL := /bin/bash
BIN := .venv/bin
export KEDRO_DISABLE_TELEMETRY := true
export DO_NOT_TRACK := 1
unexport PYTHONDONTWRITEBYTECODE  # compiling the tests anew takes a third of their collection

.PHONY: setup run compare models test quick coverage lint bench docs clean

setup:
	@./scripts/setup.sh

run: setup
	@$(BIN)/kedro run --config=conf/quick.yml
	@$(BIN)/python -m mlsroad_pipeline.commands.summary

compare: setup
	@$(BIN)/kedro run --env=compare
	@$(BIN)/kedro run --env=compare --pipelines=comparison_report

models: setup
	@$(BIN)/kedro run --env=general
	@$(BIN)/kedro run --env=general --pipelines=ground_colour
	@$(BIN)/kedro run --env=general --pipelines=object_classifier

test: setup lint
	@$(BIN)/python -m pytest -n auto --dist loadfile --no-loadscope-reorder

quick: setup
	@$(BIN)/python -m pytest -n auto --dist loadfile --no-loadscope-reorder -m "not slow and not process and not training"

coverage: setup
	@$(BIN)/python -m pytest -n auto --dist loadfile --no-loadscope-reorder --timeout=900 --cov --cov-report=term

lint: setup
	@$(BIN)/ruff check .
	@$(BIN)/ruff format --check .
	@$(BIN)/lint-imports
	@$(BIN)/mypy

bench: setup
	@$(BIN)/python benchmarks/run_all.py

docs: setup
	@$(BIN)/mkdocs build --strict

clean:
	@rm -rf .pytest_cache .mypy_cache .ruff_cache site build
