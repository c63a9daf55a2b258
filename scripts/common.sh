# shellcheck shell=bash
# What quickstart.sh and run_tests.sh share: packages, COLMAP's source, build.
# Sourced, not run. Every step is skipped when its result is already there, and
# every result gets its final name only when it is complete.

MFIR_ROOT=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd -P)
BUILD_PATH=$MFIR_ROOT/build
COLMAP_SOURCE=
COLMAP_VERSION=
COLMAP_REPOSITORY=https://github.com/colmap/colmap.git
POSELIB_SOURCE=
MPI=
MIN_FREE_MB=1000

# Everything that is used by name; all else comes as a dependency.
PACKAGES=(
  ccache cmake g++ jq libbenchmark-dev ninja-build patch
  libboost-graph-dev libboost-program-options-dev
  libboost-regex-dev libboost-system-dev libceres-dev libeigen3-dev
  libgl-dev libglew-dev libgoogle-glog-dev libgtest-dev
  libmetis-dev libminizip-dev libopencv-core-dev libopencv-dnn-dev
  libopencv-imgcodecs-dev libopencv-videoio-dev libpugixml-dev libsqlite3-dev
  libssl-dev libyaml-cpp-dev nlohmann-json3-dev
)
# Of COLMAP 3.x, and of 4.x.
PACKAGES_3=(libboost-filesystem-dev libboost-test-dev libflann-dev libfreeimage-dev liblz4-dev)
PACKAGES_MPI=(libopenmpi-dev openmpi-bin)
PACKAGES_4=(libfaiss-dev libopenimageio-dev libsuitesparse-dev openimageio-tools)

die() {
  printf '\nerror: %s\n' "$*" >&2
  exit 1
}

common_options() {
  cat <<OPTIONS
  --colmap_source DIR  own COLMAP source tree (it is copied, never written to;
                       default: that of the last run, else the distribution's
                       source package is downloaded)
  --colmap_version V   get COLMAP's release V, 3.8 or 4.1.1, with git clone
  --poselib_source DIR own tree of PoseLib, which COLMAP 4.x needs (default: its
                       build downloads it)
  --mpi                also install Open MPI and build with it, for runs on several
                       machines
  --build_path DIR     where to build (default: build in the project's folder)
  -h, --help           show this text
OPTIONS
}

# is_colmap DIR: whether it is a source tree of COLMAP, 3.x or 4.x.
is_colmap() {
  [[ -f $1/src/exe/colmap.cc || -f $1/src/colmap/exe/colmap.cc ]]
}

# is_supported VERSION: whether there is a host for that version of COLMAP.
is_supported() {
  [[ $1 =~ ^(3\.8|4\.[1-9][0-9]*(\.[0-9]+)*)$ ]]
}

# Each script defines usage(). The exit code is that of the programs.
usage_error() {
  printf 'error: %s\n\n' "$1" >&2
  usage >&2
  exit 1
}

# parse_common_option OPTION [VALUE]: handles one of common_options.
parse_common_option() {
  case $1 in
    -h | --help) usage && exit 0 ;;
    --colmap_source | --poselib_source | --build_path)
      [[ -n ${2-} ]] || usage_error "$1 needs a folder"
      ;;
    --colmap_version)
      is_supported "${2-}" || usage_error "$1 must be 3.8, or 4.1 or a later 4.x, such as 4.1.1"
      ;;
    *) usage_error "unknown option: $1" ;;
  esac
  if [[ $1 == --colmap_source ]]; then
    is_colmap "$2" || die "--colmap_source: '$2' is not a COLMAP" \
      "source tree (there is no src/exe/colmap.cc or src/colmap/exe/colmap.cc in it)"
    COLMAP_SOURCE=$(realpath "$2")
  elif [[ $1 == --colmap_version ]]; then
    COLMAP_VERSION=$2
  elif [[ $1 == --poselib_source ]]; then
    [[ -f $2/CMakeLists.txt ]] || die "--poselib_source: there is no CMakeLists.txt in '$2'"
    POSELIB_SOURCE=$(realpath "$2")
  else
    BUILD_PATH=$(realpath -m "$2")
  fi
  [[ -z $COLMAP_SOURCE || -z $COLMAP_VERSION ]] ||
    usage_error "give --colmap_source or --colmap_version, not both"
}

# run_step TEXT LOG_NAME COMMAND...: one line of progress, output to a log that
# is shown when the command fails.
run_step() {
  local text=$1 log=$BUILD_PATH/logs/$2.log start=$SECONDS
  shift 2
  printf '%s ...\n' "$text"
  if ! "$@" >"$log" 2>&1; then
    tail -n 30 "$log" >&2
    die "failed: ${text,}; the whole log: $log"
  fi
  printf '  done in %d s\n' $((SECONDS - start))
}

# make_folder PATH OPTION
make_folder() {
  if ! mkdir -p "$1" 2>/dev/null || [[ ! -w $1 ]]; then
    die "'$1' cannot be written by $(id -un); run as the user who made it," \
      "or give another folder with $2"
  fi
}

prepare_build_path() {
  make_folder "$BUILD_PATH" --build_path
  make_folder "$BUILD_PATH/logs" --build_path
  # Two runs in one build folder would disturb each other.
  exec 9>"$BUILD_PATH/.lock"
  flock -n 9 || { printf 'Waiting for another run in %s\n' "$BUILD_PATH" && flock 9; }
  [[ -x $BUILD_PATH/bin/colmap ]] && return
  local free_mb
  free_mb=$(df -Pm "$BUILD_PATH" | awk 'NR == 2 { print $4 }')
  ((free_mb >= MIN_FREE_MB)) || die "the disk of '$BUILD_PATH' has $free_mb MB free," \
    "the build needs $MIN_FREE_MB MB; free some or give another folder with --build_path"
}

# add_colmap_packages: those that the version of COLMAP_SOURCE needs.
add_colmap_packages() {
  if [[ -f $COLMAP_SOURCE/src/colmap/exe/colmap.cc ]]; then
    PACKAGES+=("${PACKAGES_4[@]}")
  else
    PACKAGES+=("${PACKAGES_3[@]}")
  fi
  [[ -z $MPI ]] || PACKAGES+=("${PACKAGES_MPI[@]}")
}

missing_packages() {
  comm -23 <(printf '%s\n' "${PACKAGES[@]}" | sort) \
    <(dpkg-query -W -f '${db:Status-Status} ${Package}\n' "${PACKAGES[@]}" 2>/dev/null |
      sed -n 's/^installed //p' | sort -u)
}

# The package lists are only refreshed when the install fails without it.
apt_install() {
  local install=("${AS_ROOT[@]}" env DEBIAN_FRONTEND=noninteractive apt-get
    -o DPkg::Lock::Timeout=300 install -y --no-install-recommends "$@")
  "${install[@]}" && return
  "${AS_ROOT[@]}" apt-get -o DPkg::Lock::Timeout=300 update
  local package
  for package in "$@"; do
    if ! apt-cache show "$package" >/dev/null 2>&1; then
      echo "The package $package is not found in the apt sources of this machine" \
        "(made for Debian 12, component main), or they could not be reached."
      return 1
    fi
  done
  "${install[@]}" && return
  echo "apt-get cannot install the packages named above: is the network up?"
  return 1
}

install_packages() {
  if ! command -v apt-get >/dev/null; then
    local tool
    for tool in cmake ninja g++ patch; do
      command -v "$tool" >/dev/null || die "'$tool' is missing, and there is no apt-get to" \
        "install it with. Install what these Debian packages contain: ${PACKAGES[*]}"
    done
    return
  fi
  local missing
  mapfile -t missing < <(missing_packages)
  ((${#missing[@]})) || return 0
  AS_ROOT=()
  if ((EUID != 0)); then
    command -v sudo >/dev/null || die "packages are missing, and neither is this root nor" \
      "is there sudo. Run as root: apt-get install ${missing[*]}"
    AS_ROOT=(sudo)
  fi
  printf 'Missing packages: %s\n' "${missing[*]}"
  run_step "Installing ${#missing[@]} packages" apt_install apt_install "${missing[@]}"
}

# The machine's own apt sources as sources of source packages, in folder $1.
# Nothing outside of the build folder is written, so this needs no root.
write_source_lists() {
  local list parts file
  eval "$(apt-config shell list Dir::Etc::sourcelist/f parts Dir::Etc::sourceparts/d)"
  for file in "$list" "$parts"/*.list; do
    [[ -r $file ]] || continue
    sed -nE '/cdrom:/d; s/^[[:space:]]*deb[[:space:]]/deb-src /p' "$file" >"$1/${file##*/}"
  done
  for file in "$parts"/*.sources; do
    [[ -r $file ]] || continue
    sed -E 's/^Types:.*/Types: deb-src/I' "$file" >"$1/${file##*/}"
  done
}

# Prints the newest offered version that is supported.
pick_colmap_version() {
  local version upstream
  while read -r version; do
    upstream=${version#*:}
    upstream=${upstream%-*}
    if is_supported "${upstream%%[+~]*}"; then
      echo "$version"
      return
    fi
  done < <(sort -Vr)
  return 1
}

# Downloads and unpacks COLMAP's source package into the new folder $1/colmap.
# apt verifies signatures and checksums.
download_colmap() {
  local offered version apt=(
    -o Dir::Etc::SourceList=/dev/null -o Dir::Etc::SourceParts="$1/sources"
    -o Dir::State::Lists="$1/lists" -o Dir::Cache="$1/cache"
    -o APT::Sandbox::User=root)
  rm -rf "$1"
  mkdir -p "$1"/{sources,lists/partial,cache/archives/partial,colmap}
  write_source_lists "$1/sources"
  # One unreachable source among several does not matter.
  apt-get "${apt[@]}" update || true
  offered=$(apt-cache "${apt[@]}" showsrc --only-source colmap | sed -n 's/^Version: //p' | sort -u)
  if ! version=$(pick_colmap_version <<<"$offered"); then
    printf '%s\n' "" \
      "The apt sources of this machine offer no source package of a COLMAP version that is" \
      "supported (3.8, 4.1 and later 4.x; offered: ${offered:-none; is the network up?}). Get a" \
      "release with --colmap_version 4.1.1, which does the following, or give an own tree:" \
      "git clone --depth 1 --branch 4.1.1 $COLMAP_REPOSITORY && $0 --colmap_source colmap"
    return 1
  fi
  (cd "$1" && apt-get "${apt[@]}" source --download-only "colmap=$version") || return 1
  rm -rf "$1"/{sources,lists,cache}
  tar -xf "$1"/colmap_*.orig.tar.* -C "$1/colmap" --strip-components=1
}

# clone_colmap FOLDER: the release COLMAP_VERSION.
clone_colmap() {
  rm -rf "$1"
  git -c advice.detachedHead=false clone --depth 1 --branch "$COLMAP_VERSION" "$COLMAP_REPOSITORY" "$1" &&
    return
  echo "The release $COLMAP_VERSION cannot be cloned: is it a tag there, and is the network up?"
  return 1
}

# Sets COLMAP_SOURCE, unless given: the release that is asked for, the tree of
# the last run, else a download.
find_colmap_source() {
  [[ -z $COLMAP_SOURCE ]] || return 0
  if [[ -n $COLMAP_VERSION ]]; then
    COLMAP_SOURCE=$BUILD_PATH/colmap-$COLMAP_VERSION
    [[ ! -d $COLMAP_SOURCE ]] || return 0
    command -v git >/dev/null || die "git is missing: install it, or give a tree with --colmap_source DIR"
    run_step "Cloning COLMAP $COLMAP_VERSION" colmap_clone clone_colmap "$COLMAP_SOURCE.partial"
    mv "$COLMAP_SOURCE.partial" "$COLMAP_SOURCE"
    return
  fi
  local cache=$BUILD_PATH/CMakeCache.txt download=$BUILD_PATH/colmap_download
  if [[ -f $cache ]]; then
    COLMAP_SOURCE=$(sed -n 's/^MFIR_COLMAP_SOURCE:[A-Z]*=//p' "$cache")
    ! is_colmap "$COLMAP_SOURCE" || return 0
  fi
  COLMAP_SOURCE=$download/colmap
  [[ ! -d $COLMAP_SOURCE ]] || return 0
  command -v apt-get >/dev/null ||
    die "there is no apt-get to get COLMAP's source with; give a tree with --colmap_source DIR"
  run_step "Getting COLMAP's source package" colmap_download download_colmap "$download.partial"
  rm -rf "$download"
  mv "$download.partial" "$download"
}

configure() {
  # Lets a clone in another folder, or of another user, hit the compiler cache.
  export CCACHE_BASEDIR=$MFIR_ROOT CCACHE_NOHASHDIR=1 CCACHE_SLOPPINESS=locale
  local arguments=(-DMFIR_COLMAP_SOURCE="$COLMAP_SOURCE")
  [[ -z $MPI ]] || arguments+=(-DMFIR_MPI_ENABLED=ON)
  # COLMAP renames a folder of PoseLib's: in a copy.
  if [[ -n $POSELIB_SOURCE ]]; then
    rm -rf "$BUILD_PATH/poselib_source"
    cp -rp "$POSELIB_SOURCE" "$BUILD_PATH/poselib_source"
    arguments+=(-DFETCHCONTENT_SOURCE_DIR_POSELIB="$BUILD_PATH/poselib_source")
  fi
  run_step "Configuring with COLMAP in $COLMAP_SOURCE" configure \
    cmake -S "$MFIR_ROOT" -B "$BUILD_PATH" -G Ninja "${arguments[@]}"
}

# set_up_preset PRESET TARGET...: the same in BUILD_PATH/PRESET, by a preset of
# CMakePresets.json.
set_up_preset() {
  local preset=$1
  shift
  prepare_build_path
  install_packages
  find_colmap_source
  add_colmap_packages
  install_packages
  BUILD_PATH=$BUILD_PATH/$preset
  prepare_build_path
  export CCACHE_BASEDIR=$MFIR_ROOT CCACHE_NOHASHDIR=1 CCACHE_SLOPPINESS=locale
  export MFIR_COLMAP_SOURCE=$COLMAP_SOURCE
  run_step "Configuring the preset $preset" configure \
    cmake -S "$MFIR_ROOT" --preset "$preset" -B "$BUILD_PATH"
  build "$@"
}

# Passes ninja's output on to a log, and a line per tenth of the work to stdout.
show_progress() {
  local log=$1 start=$SECONDS tenth=0 line
  while IFS= read -r line; do
    printf '%s\n' "$line"
    if [[ $line =~ ^\[([0-9]+)/([0-9]+)\] ]] &&
      ((BASH_REMATCH[1] * 10 / BASH_REMATCH[2] > tenth)); then
      tenth=$((BASH_REMATCH[1] * 10 / BASH_REMATCH[2]))
      printf '  %3d %% (%s of %s steps, %d s)\n' $((tenth * 10)) \
        "${BASH_REMATCH[1]}" "${BASH_REMATCH[2]}" $((SECONDS - start)) >&3
    fi
  done 3>&1 >"$log"
}

# build TARGET...
build() {
  local log=$BUILD_PATH/logs/build.log jobs memory_jobs
  # The largest files need 2.5 GB of memory to compile.
  memory_jobs=$(awk '/^MemAvailable:/ { print int($2 / 2.5e6) }' /proc/meminfo)
  jobs=$(nproc)
  ((memory_jobs >= jobs)) || jobs=$((memory_jobs > 1 ? memory_jobs : 1))
  printf 'Building %s with %d jobs (the first time takes minutes) ...\n' "$*" "$jobs"
  if ! ninja -C "$BUILD_PATH" -j "$jobs" "$@" 2>&1 | show_progress "$log"; then
    # The first failure tells the cause; what follows belongs to other jobs.
    { grep -A 40 -m 1 '^FAILED: ' "$log" || tail -n 30 "$log"; } >&2
    die "the build failed; the whole log: $log"
  fi
}

# set_up TARGET...: from a fresh machine to the built targets.
set_up() {
  prepare_build_path
  # Twice: getting the source may need tools, and tells the version.
  install_packages
  find_colmap_source
  add_colmap_packages
  install_packages
  configure
  build "$@"
}
