# Tests of navrl in a container: docker build -t navrl . && docker run --rm navrl
# docs/containers.md describes both stages.
FROM python:3.11-slim-bookworm AS base
# git: the commit in records of runs; chromium and ffmpeg: tests of pages and videos.
RUN apt-get update -qq && apt-get install -y -qq --no-install-recommends git chromium ffmpeg \
    && rm -rf /var/lib/apt/lists/*

FROM base AS test
WORKDIR /navrl
COPY . .
# The README's second command, in two halves: what is installed, and what runs.
RUN python3 -m venv .venv && .venv/bin/pip install -q -c constraints.txt -e ".[test,docs]"
CMD .venv/bin/python -m pytest -n auto
