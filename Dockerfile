# tg4mm on the CPU, without Blender: docker build -t tg4mm .
#   docker run --rm -v "$PWD:/work" tg4mm train data/mic_5Hz_0_005 --out runs/mic
#   docker run --rm -v "$PWD:/work" --network host tg4mm view runs/mic --no-open
FROM python:3.11-slim

# OpenMP's threads, which numba takes where it finds them.
RUN apt-get update && apt-get install -y --no-install-recommends libgomp1 && rm -rf /var/lib/apt/lists/*

COPY . /src
# The whole of the program, with poses from photographs and videos (sfm) and the viewer.
RUN pip install --no-cache-dir -c /src/constraints.txt '/src[core,sfm,view]' \
    --extra-index-url https://download.pytorch.org/whl/cpu && rm -rf /src

# Compiled kernels are kept where any user may write.
ENV NUMBA_CACHE_DIR=/tmp/tg4mm-kernels
WORKDIR /work
ENTRYPOINT ["tg4mm"]
