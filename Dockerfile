# Builds objects, with a CPU build of torch (docs/workspaces.md#in-a-container). Written without a machine that could run it.
FROM python:3.12-slim-bookworm
RUN apt-get update \
 && apt-get install -y --no-install-recommends git \
 && rm -rf /var/lib/apt/lists/*
COPY . /opt/objectfolder
RUN pip install --no-cache-dir -c /opt/objectfolder/constraints.txt \
      --extra-index-url https://download.pytorch.org/whl/cpu '/opt/objectfolder[build]'
# Any user may run it: `docker run --user "$(id -u):$(id -g)"`.
ENV HOME=/tmp
WORKDIR /workspace
ENTRYPOINT ["objectfolder"]
