#!/bin/sh
# The virtual machine that the tests marked `usbvm` run in: QEMU, what its first file system is made of, and
# a kernel with USB sound, which is unpacked into .cache/usb-vm and installed nowhere.
#
# Debian and Ubuntu, x86-64. Where it cannot be had this says so and exits 0: the tests then skip.
set -eu

unset CDPATH
cd "$(dirname "$0")/.."
. tools/system_packages.sh
who=usb-vm
folder=.cache/usb-vm

[ "$(uname -m)" = x86_64 ] || without "it is made for x86_64, and this is $(uname -m)"
install_packages "$who" qemu-system-x86 busybox-static cpio kmod alsa-utils
[ ! -f "$folder/ready" ] || exit 0

# Debian's meta package, or Ubuntu's, leads to the newest kernel that there is.
newest_kernel() {
    for meta in linux-image-amd64 linux-image-generic; do
        apt-cache depends "$meta" 2>/dev/null | sed -n 's/^ *Depends: \(linux-image-[0-9].*\)$/\1/p'
    done | head -n 1
}

kernel=$(newest_kernel)
if [ -z "$kernel" ]; then
    apt_get update || true
    kernel=$(newest_kernel)
fi
[ -n "$kernel" ] || without "apt-get knows of no kernel"

scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT
say "fetching $kernel"
(cd "$scratch" && apt-get -q download "$kernel" >/dev/null 2>&1) || without "$kernel cannot be fetched (no network?)"

rm -rf "$folder"
mkdir -p "$folder"
dpkg-deb --fsys-tarfile "$scratch"/linux-image-*.deb | tar -x -C "$folder" --wildcards \
    './boot/vmlinuz-*' './lib/modules/*/modules.*' './lib/modules/*/kernel/drivers/usb/*' \
    './lib/modules/*/kernel/drivers/virtio/*' './lib/modules/*/kernel/sound/*' \
    './lib/modules/*/kernel/net/9p/*' './lib/modules/*/kernel/fs/9p/*' './lib/modules/*/kernel/fs/fscache/*' \
    './lib/modules/*/kernel/fs/netfs/*' './lib/modules/*/kernel/fs/overlayfs/*' \
    './lib/modules/*/kernel/drivers/media/mc/*' './lib/modules/*/kernel/lib/*' './lib/modules/*/kernel/crypto/*'
release=$(ls "$folder/lib/modules")
/sbin/depmod -b "$folder" "$release" 2>/dev/null
printf '%s\n' "$release" >"$folder/ready"
say "done: kernel $release"
