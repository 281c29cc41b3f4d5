#!/bin/sh
# Certificates of one cluster, for a season: an authority of its own, and a certificate each for scheduler, workers and
# client.
#
#   tools/deploy/certificates.sh FOLDER [DAYS]      # 30 days unless told
#
# Whoever holds one of the keys may have every worker do what they like: the keys are the cluster's only doorkeeper. So
# they are short-lived, and the authority's own key is not kept: nobody can let another in later. A cluster that
# outlives its certificates gets all of them anew, in another folder.
set -eu
umask 077
[ $# -ge 1 ] && [ $# -le 2 ] || { sed -n '2,9s/^# \{0,1\}//p' "$0" >&2; exit 2; }
folder=$1 days=${2:-30}
case $days in '' | *[!0-9]* | 0*) echo "certificates.sh: $days: expected a number of days, 1 to 397" >&2; exit 2 ;; esac
[ "$days" -le 397 ] || { echo "certificates.sh: $days: expected a number of days, 1 to 397" >&2; exit 2; }
[ ! -e "$folder" ] || { echo "certificates.sh: $folder: is there already. Expected a folder to be made" >&2; exit 1; }

work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
trap 'exit 1' HUP INT TERM
new="$work/made"
mkdir "$new"
key() { openssl genpkey -algorithm EC -pkeyopt ec_paramgen_curve:P-256 -out "$1"; }

cat >"$work/ca.cnf" <<'END'
[req]
distinguished_name = name
prompt = no
x509_extensions = ca
[name]
CN = annulus cluster
[ca]
basicConstraints = critical, CA:TRUE, pathlen:0
keyUsage = critical, keyCertSign
subjectKeyIdentifier = hash
END
key "$work/ca.key"
openssl req -x509 -new -sha256 -config "$work/ca.cnf" -key "$work/ca.key" -days "$days" -out "$new/ca.pem"

signed() { # name, what it may be
	key "$new/$1.key"
	openssl req -new -sha256 -subj "/CN=annulus $1" -config "$work/ca.cnf" -key "$new/$1.key" -out "$work/$1.csr"
	cat >"$work/$1.ext" <<-END
		basicConstraints = critical, CA:FALSE
		keyUsage = critical, digitalSignature
		extendedKeyUsage = $2
		subjectKeyIdentifier = hash
		authorityKeyIdentifier = keyid
		subjectAltName = DNS:$1, DNS:localhost, IP:127.0.0.1
	END
	openssl x509 -req -sha256 -in "$work/$1.csr" -CA "$new/ca.pem" -CAkey "$work/ca.key" -days "$days" \
		-set_serial "0x$(openssl rand -hex 16)" -extfile "$work/$1.ext" -out "$new/$1.pem" 2>"$work/said" || { cat "$work/said" >&2; exit 1; }
}
signed scheduler serverAuth,clientAuth # it calls workers, too
signed worker serverAuth,clientAuth
signed client clientAuth # hands out work, and can pose as nobody

chmod 0644 "$new"/*.pem
mkdir -p "$(dirname "$folder")"
mv "$new" "$folder"
echo "$folder: ca.pem; scheduler, worker, client: .pem and .key; for $days days"
