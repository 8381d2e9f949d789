#!/bin/sh
# Makes sure that this Linux machine can build and render: a C++ compiler, the Vulkan loader and a Vulkan driver.
# On Debian and Ubuntu, as root, it installs what is missing; elsewhere it says what to install.
#
# Usage: driver.sh NEED STRICT [PROGRAMS [ROOT]]
#   NEED      vulkan; or ray-query, if the CPU driver must have ray queries
#   STRICT    1 if missing ray queries are a failure, else empty
#   PROGRAMS  other programs that must be there, each with its package: spirv-val:spirv-tools
#   ROOT      prefix of system files, for tests
# Progress goes to stderr. On failure, stdout holds the reason.
set -eu
need=$1 strict=$2 programs=${3-} root=${4-}
ray_query_mesa=24.1 # The first Mesa whose CPU driver has ray queries.
PATH=$PATH:/usr/sbin:/sbin

say() { echo "    $*" >&2; }
fail() { echo "$*"; exit 1; }
# Without a linker cache there is nothing to ask, and the loader is taken to be there.
has_loader() { ! command -v ldconfig >/dev/null || ldconfig -p | grep -q 'libvulkan\.so\.1 '; }

# Virtual GPUs (virtio, VMware, QEMU, VirtualBox, Parallels) seldom have Vulkan and don't count.
has_gpu() {
  if [ -e "$root/dev/nvidiactl" ] || [ -e "$root/dev/dxg" ]; then return 0; fi
  for device in "$root"/dev/dri/renderD*; do
    vendor=$root/sys/class/drm/${device##*/}/device/vendor
    if [ -e "$device" ] && ! grep -qsE '0x(1af4|15ad|1234|80ee|1ab8)' "$vendor"; then return 0; fi
  done
  return 1
}

# Mesa installs the manifests of all drivers at once: without a GPU, only those of CPU drivers count.
has_driver() {
  for folder in "${XDG_CONFIG_HOME:-${HOME-}/.config}" "${XDG_DATA_HOME:-${HOME-}/.local/share}" \
    /etc/xdg /usr/local/etc /etc $(echo "${XDG_DATA_DIRS:-/usr/local/share:/usr/share}" | tr : ' '); do
    for manifest in "$root$folder"/vulkan/icd.d/*.json; do
      [ -e "$manifest" ] || continue
      case $gpu$manifest in 1* | *lvp_icd* | *swiftshader*) return 0 ;; esac
    done
  done
  return 1
}

mesa_version() { dpkg-query -W -f '${Version}' mesa-vulkan-drivers 2>/dev/null || true; }
is_old() { [ -n "$1" ] && dpkg --compare-versions "$1" lt "$ray_query_mesa" 2>/dev/null; }
lacks_ray_queries() { [ "$need" = ray-query ] && [ -z "$gpu$chosen" ] && is_old "$(mesa_version)"; }

apt() {
  DEBIAN_FRONTEND=noninteractive apt-get -qq -o DPkg::Lock::Timeout=120 "$@" </dev/null >&2 && return
  echo "\`apt-get $*\` failed"; return 1
}

# Makes backports a source of the apt-get calls with `-o $with_backports`; the machine's own sources stay as they are. What comes
# from there must be signed by Debian, even if the machine trusts its mirror without a signature.
add_backports() {
  mirror=$(apt-get indextargets --format '$(REPO_URI)' 'Created-By: Packages' "Release: $VERSION_CODENAME" 'Component: main' |
    sed '/^cdrom:/d' | head -n 1)
  [ -n "$mirror" ] || { echo "apt has no mirror of $VERSION_CODENAME to take backports from"; return 1; }
  say "Mesa $candidate has no ray queries; will take it from $VERSION_CODENAME-backports ($mirror), a source for this call alone"
  mkdir "$scratch/sources"
  cp "$root"/etc/apt/sources.list.d/* "$scratch/sources" 2>/dev/null || true
  printf 'Types: deb\nURIs: %s\nSuites: %s-backports\nComponents: main\nSigned-By: %s\n' "$mirror" "$VERSION_CODENAME" \
    /usr/share/keyrings/debian-archive-keyring.gpg >"$scratch/sources/glint-backports.sources"
  apt -o "$with_backports" update
}

install() {
  say "will run apt-get update and apt-get install$packages (GLINT_SKIP_DRIVER_CHECK=1 prevents it)"
  apt update || return
  set -- install --yes --no-install-recommends
  candidate=$(apt-cache policy mesa-vulkan-drivers | sed -n 's/^ *Candidate: *//p')
  if [ "$ID" = debian ] && [ "${packages%mesa*}" != "$packages" ] && is_old "$candidate"; then
    if reason=$(add_backports); then
      set -- -o "$with_backports" "$@" --target-release "$VERSION_CODENAME-backports"
    elif [ "$need" = ray-query ]; then echo "$reason"; return 1; fi
  fi
  apt "$@" $packages || return
  ! lacks_ray_queries || { echo "$PRETTY_NAME has Mesa $(mesa_version)"; return 1; }
}

chosen=${VK_DRIVER_FILES:-${VK_ICD_FILENAMES-}}
for manifest in $(echo "$chosen" | tr : ' '); do
  [ -e "$manifest" ] || fail "VK_DRIVER_FILES or VK_ICD_FILENAMES names $manifest, which doesn't exist; correct or unset it"
done
gpu= packages=
if has_gpu; then gpu=1; fi
if [ -z "${CXX-}" ] && ! command -v c++ >/dev/null; then packages=' g++'; fi
for program in $programs; do
  command -v "${program%%:*}" >/dev/null || packages="$packages ${program#*:}"
done
if ! has_loader; then packages="$packages libvulkan1"; fi
if [ -z "$chosen" ] && ! has_driver; then packages="$packages mesa-vulkan-drivers"; fi
missing=$packages
if lacks_ray_queries; then packages="${packages% mesa-vulkan-drivers} mesa-vulkan-drivers"; fi
[ -n "$packages" ] || exit 0

ID='' ID_LIKE='' PRETTY_NAME='this system' VERSION_CODENAME=''
if [ -e "$root/etc/os-release" ]; then . "$root/etc/os-release"; fi
scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT
trap 'exit 130' HUP INT TERM
with_backports=Dir::Etc::SourceParts=$scratch/sources
case " $ID $ID_LIKE " in
  *' debian '* | *' ubuntu '*)
    if [ "$(id -u)" != 0 ]; then reason="run this as root, or install$packages"
    elif reason=$(install); then exit 0; fi ;;
  *) reason="$PRETTY_NAME is neither Debian nor Ubuntu: install what Debian calls$packages" ;;
esac
case $need$packages in ray-query*mesa*) reason="$reason (ray queries on the CPU need Mesa $ray_query_mesa)" ;; esac
[ -z "$missing$strict" ] || fail "this machine lacks$packages; $reason (GLINT_SKIP_DRIVER_CHECK=1 skips this check)"
say "tests that need ray queries will skip: $reason"
