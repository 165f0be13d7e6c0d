# shellcheck shell=bash
# Sourced by the scripts next to it: installs the tools that they need.

die() { echo "error: $*" >&2; exit 1; }

sudo=
apt_updated=
apt_update() {
    [[ -z $apt_updated ]] || return 0
    command -v apt-get >/dev/null || die "there is no apt-get to install $*. Install it by hand."
    if ((EUID != 0)); then
        sudo=$(command -v sudo) || die "installing $* needs root or sudo. Install it by hand."
    fi
    $sudo apt-get update -q || die "apt-get could not update its lists to install $*."
    apt_updated=yes
}

# --no-remove: never replace a contributor's own packages.
apt_options=(-q -y --no-install-recommends --no-remove)
apt_install() { # packages...
    apt_update "$@"
    $sudo env DEBIAN_FRONTEND=noninteractive apt-get install "${apt_options[@]}" "$@" ||
        die "apt-get could not install $*. Install it by hand."
}

need() { # program, packages...
    command -v "$1" >/dev/null || apt_install "${@:2}"
    command -v "$1" >/dev/null || die "$1 is still missing after installing ${*:2}."
}

# If a newer qemu-utils is installed, apt-get cannot install an emulator without removing it. Then the emulator is
# unpacked in a folder, and only its dependencies are installed.
need_qemu() { # program, package, folder
    PATH=$PATH:$3/usr/bin
    "$1" --version >/dev/null 2>&1 && return
    apt_update "$2"
    if apt-get install --simulate "${apt_options[@]}" "$2" >/dev/null 2>&1; then
        need "$1" "$2"
        return
    fi

    echo "apt-get cannot install $2 next to the installed packages: it is unpacked in $3."
    # shellcheck disable=SC2046 # several packages
    apt_install --no-upgrade $(apt-cache depends "$2" | awk '$1 == "Depends:" && $2 !~ /^qemu-/ { print $2 }')
    rm -rf "$3" "$3.part"
    mkdir -p "$3.part"
    (
        cd "$3.part"
        apt-get download -q "$2" qemu-system-common qemu-system-data
        for package in *.deb; do dpkg-deb -x "$package" .; done
        rm ./*.deb
    )
    mv "$3.part" "$3"
    "$1" --version >/dev/null || die "$1, unpacked in $3, does not run. Install it by hand."
}

# Sets `python`, the folder of an environment with the packages of .ci/requirements.txt. Creates it if necessary.
need_python_env() { # folder
    python=$1
    cmp -s .ci/requirements.txt "$python/requirements.txt" && return
    python3 -c 'import ensurepip, venv' 2>/dev/null || apt_install python3 python3-venv
    rm -rf "$python"
    python3 -m venv "$python"
    "$python/bin/pip" install -q --disable-pip-version-check -r .ci/requirements.txt ||
        die "pip could not install the packages of .ci/requirements.txt."
    cp .ci/requirements.txt "$python/"
}
