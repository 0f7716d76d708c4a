# tg4mm on the CPU: docker build -t tg4mm .
#   docker run --rm -v "$PWD:/work" tg4mm demo --out demo
#   docker run --rm -v "$PWD:/work" tg4mm train data/mic_5Hz_0_005 --out runs/mic
#   docker run --rm -v "$PWD:/work" --network host tg4mm view runs/mic --no-open
FROM python:3.11-slim

# OpenMP's threads, which numba takes where it finds them; what Blender's module links against.
RUN apt-get update && apt-get install -y --no-install-recommends libgomp1 \
    libx11-6 libxrender1 libxfixes3 libxi6 libxext6 libxkbcommon0 libsm6 libgl1 libegl1 && rm -rf /var/lib/apt/lists/*

COPY . /src
# The whole of the program.
RUN pip install --no-cache-dir -c /src/constraints.txt '/src[core,generate,sfm,view,flip]' \
    --extra-index-url https://download.pytorch.org/whl/cpu && rm -rf /src

# Compiled kernels are kept where any user may write.
ENV NUMBA_CACHE_DIR=/tmp/tg4mm-kernels
WORKDIR /work
ENTRYPOINT ["tg4mm"]
