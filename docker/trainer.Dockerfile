# The trainer with a CPU build of torch. Build from the repository's root.
ARG PYTHON_IMAGE=python:3.11-slim
FROM ${PYTHON_IMAGE}
# Looked at beside PyPI, and for torch alone; PyPI's own build brings gigabytes of CUDA.
ARG TORCH=torch==2.13.0
ARG TORCH_INDEX=https://download.pytorch.org/whl/cpu
WORKDIR /app
RUN pip install --no-cache-dir --no-deps --extra-index-url "${TORCH_INDEX}" "${TORCH}"
COPY pyproject.toml constraints.txt LICENSE ./
# What it needs, in a layer of its own: a change of the source does not install it again.
RUN touch README.md && pip install --no-cache-dir --constraint constraints.txt '.[trainer]'
COPY corridor_server corridor_server
COPY trainer trainer
RUN pip install --no-cache-dir --no-deps --force-reinstall . && rm -rf /app/* /root/.cache && mkdir results
ENV PYTHONUNBUFFERED=1 HOME=/tmp MPLCONFIGDIR=/tmp/matplotlib
USER 1000:1000
HEALTHCHECK --interval=5s --timeout=5s --start-period=120s --retries=3 \
  CMD ["python3", "-c", "import socket; socket.create_connection(('localhost', 5005), 2)"]
ENTRYPOINT ["corridor"]
CMD ["--help"]
