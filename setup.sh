#!/usr/bin/env bash
# Mesa's lavapipe: a Vulkan device made of the CPU, for machines without a GPU. On Debian and Ubuntu.
set -euo pipefail
if ! ls /usr/share/vulkan/icd.d/lvp_icd*.json >/dev/null 2>&1; then
  root() { if [ "$(id -u)" = 0 ]; then "$@"; else sudo "$@"; fi; }
  root apt-get update -qq
  root env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends mesa-vulkan-drivers libvulkan1
fi
