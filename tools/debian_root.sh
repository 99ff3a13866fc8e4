#!/bin/bash
# Runs a command of this checkout on another Debian, with its PipeWire and its Python:
#
#   tools/debian_root.sh [--new] SUITE COMMAND...      such as: tools/debian_root.sh trixie make test
#
# SUITE: trixie (PipeWire 1.4, Python 3.13), sid (PipeWire 1.6, Python 3.14) or any other of Debian's.
# --new: forget the .venv and all that earlier commands made in the copy.
#
# The first call builds a root with mmdebstrap in two to four minutes and keeps it in CUSHION_ROOTS (default:
# ~/.cache/haptic-cushion/roots). Each call copies the tracked and new files of this checkout into it, to /project.
# The command sees a /tmp and processes of its own, which end with it; its exit code is this script's.
# Debian's mirror and pip's settings are those of this machine. As root, on Debian or Ubuntu.
set -euo pipefail

say() { printf 'debian_root: %s\n' "$*" >&2; }
die() {
    say "error: $*"
    exit 2
}

fresh=no
if [ "${1-}" = --new ]; then
    fresh=yes
    shift
fi
[ $# -ge 2 ] || die "usage: tools/debian_root.sh [--new] SUITE COMMAND..."
suite=$1
shift
checkout=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd -P)
roots=${CUSHION_ROOTS:-$HOME/.cache/haptic-cushion/roots}
root=$roots/$suite

[ "$(id -u)" = 0 ] || die "a root of Debian needs the user root; run it with sudo"
command -v apt-get >/dev/null || die "this system has no apt-get to build a root of Debian with"
unshare --mount --pid --fork true 2>/dev/null || die "this system allows no namespaces (unshare)"

# What set-up itself may install would do as well; it is here so that each copy does not fetch it again.
packages=ca-certificates,git,make,gcc,libc6-dev,python3,python3-dev,python3-venv,portaudio19-dev,libasound2-plugins
packages=$packages,procps,util-linux,rsync

# The address from which this machine gets the packages of its own release.
mirror() {
    # shellcheck disable=SC1091
    own=$(. /etc/os-release && echo "$VERSION_CODENAME")
    apt-get indextargets --format '$(SITE) $(RELEASE)' 'Created-By: Packages' |
        awk -v own="$own" '$2 == own { print $1; exit }'
}

build() {
    command -v mmdebstrap >/dev/null || {
        apt-get -q update
        apt-get -q -y install --no-install-recommends mmdebstrap
    } >&2
    from=$(mirror)
    [ -n "$from" ] || {
        apt-get -q update >&2
        from=$(mirror)
    }
    [ -n "$from" ] || die "apt knows no mirror of this machine's own release"
    say "building $root"
    rm -rf "$root"
    # lists of a mirror that lags may have expired; their signatures are checked
    mmdebstrap --quiet --variant=minbase --include="$packages" \
        --aptopt='APT::Install-Recommends "false"' --aptopt='Acquire::Check-Valid-Until "false"' \
        --aptopt='Acquire::Languages "none"' --dpkgopt=force-unsafe-io \
        --dpkgopt='path-exclude=/usr/share/doc/*' --dpkgopt='path-exclude=/usr/share/man/*' \
        --dpkgopt='path-exclude=/usr/share/locale/*' "$suite" "$root" "deb $from $suite main" >&2
    printf '#!/bin/sh\nexit 101\n' >"$root/usr/sbin/policy-rc.d" # packages start no services
    chmod +x "$root/usr/sbin/policy-rc.d"
    mkdir -p "$root/project"
    touch "$root/.complete"
}

# The files and folders of this machine that pip's settings name.
pip_paths() {
    {
        python3 -m pip config debug 2>/dev/null | sed -n 's/^ *\(\/.*\), exists: True$/\1/p'
        { python3 -m pip config list 2>/dev/null || true; env | grep '^PIP_' || true; echo "${SSL_CERT_FILE-}"; } |
            tr " ='\"" '\n\n\n\n' | sed -n 's#^file://##; s#/simple/*$##; /^\//p'
    } | sort -u | while read -r path; do
        [ ! -e "$path" ] || echo "$path"
    done
}

mkdir -p "$roots"
exec 9>"$roots/$suite.lock"
flock 9
[ -e "$root/.complete" ] || build
[ "$fresh" = no ] || rm -rf "$root/project" "$root/root/.cache/pip"
mkdir -p "$root/project"
flock -u 9

(cd "$checkout" && git ls-files --cached --others --exclude-standard -z) >"$root/files"
PATHS=$(pip_paths) ROOT=$root CHECKOUT=$checkout exec unshare --mount --pid --fork --kill-child --propagation private \
    bash -euo pipefail -c '
mount --bind "$ROOT" "$ROOT"
mount -t proc proc "$ROOT/proc"
mount --rbind /dev "$ROOT/dev"
mount --rbind /sys "$ROOT/sys"
mount -t tmpfs -o mode=755 run "$ROOT/run"
mount -t tmpfs -o mode=1777 tmp "$ROOT/tmp"
cp -L /etc/resolv.conf "$ROOT/etc/resolv.conf" 2>/dev/null || true
cp -L /etc/hosts "$ROOT/etc/hosts" 2>/dev/null || true
while read -r path; do
    [ -n "$path" ] || continue
    if [ -d "$path" ]; then
        mkdir -p "$ROOT$path"
    else
        mkdir -p "$ROOT$(dirname "$path")"
        touch "$ROOT$path"
    fi
    mount --bind -o ro "$path" "$ROOT$path"
done <<<"$PATHS"
mkdir -p "$ROOT/srv/checkout"
mount --bind -o ro "$CHECKOUT" "$ROOT/srv/checkout"
unset PATHS CHECKOUT XDG_RUNTIME_DIR XDG_CACHE_HOME XDG_CONFIG_HOME DBUS_SESSION_BUS_ADDRESS PULSE_SERVER \
    PIPEWIRE_RUNTIME_DIR VIRTUAL_ENV MAKEFLAGS MFLAGS MAKELEVEL
root=$ROOT
unset ROOT
export HOME=/root PATH=/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin
exec chroot "$root" bash -euo pipefail -c "
# what was deleted in the checkout goes, what commands have made here stays
cd /project
if [ -f .checkout-files ]; then
    sort -z .checkout-files | comm -z -23 - <(sort -z /files) | xargs -0 -r rm -f --
fi
cp /files .checkout-files
rsync -a --files-from=/files --from0 --ignore-missing-args /srv/checkout/ ./
git ls-files -z >/dev/null 2>&1 || git init -q .
exec \"\$@\"" root "$@"' root "$@"
