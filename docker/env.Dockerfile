# The corridor's player: Python, numpy, grpcio and protobuf. Build from the repository's root.
ARG PYTHON_IMAGE=python:3.11-slim
FROM ${PYTHON_IMAGE}
WORKDIR /app
COPY pyproject.toml constraints.txt LICENSE ./
# What it needs, in a layer of its own: a change of the source does not install it again.
RUN touch README.md && pip install --no-cache-dir --constraint constraints.txt .
COPY corridor_server corridor_server
COPY trainer trainer
RUN pip install --no-cache-dir --no-deps --force-reinstall . && rm -rf /app/* /root/.cache
COPY docker/players.py /usr/local/bin/players.py
# Unity writes to its home; the root file system is read-only, /tmp is not.
ENV PYTHONUNBUFFERED=1 HOME=/tmp
USER 1000:1000
ENTRYPOINT ["python3", "/usr/local/bin/players.py"]
CMD ["corridor-server"]
