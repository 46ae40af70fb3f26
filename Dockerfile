# The package with the simulator, at the versions that uv.lock names. For a GPU (the default) or, half the size, without:
#
#   docker build --tag lerobot-buds .                                        # CUDA, whose libraries come with PyTorch
#   docker build --tag lerobot-buds:cpu --build-arg COMPUTE=cpu .
#   docker run --rm --gpus all --volume "$PWD/outputs:/app/outputs" lerobot-buds lerobot-buds-doctor
FROM python:3.12-slim-bookworm

RUN apt-get update \
 && apt-get install --yes --no-install-recommends libegl1 libgl1-mesa-dri libopengl0 ffmpeg \
 && rm -rf /var/lib/apt/lists/*

WORKDIR /opt/lerobot_buds
COPY pyproject.toml uv.lock README.md LICENSE lerobot_policy_buds.py ./
COPY lerobot_buds lerobot_buds

ARG COMPUTE=cuda
RUN case "$COMPUTE" in cuda) backend= ;; cpu) backend=--torch-backend=cpu ;; *) exit 2 ;; esac \
 && pip install --no-cache-dir uv \
 && uv export --frozen --no-dev --extra sim --no-emit-project --no-hashes --quiet --output-file /tmp/locked.txt \
 && uv pip install --system --no-cache --only-binary :all: --no-binary lerobot-policy-buds \
      --constraint /tmp/locked.txt $backend '.[sim]' \
 && uv pip install --system --no-cache --no-deps robosuite==1.5.1 \
 && rm /tmp/locked.txt

# What a container may use of the GPU: drawing as well as computing.
ENV MUJOCO_GL=egl NVIDIA_DRIVER_CAPABILITIES=compute,utility,graphics
COPY configs /app/configs
COPY examples /app/examples
WORKDIR /app
CMD ["lerobot-buds-doctor"]
