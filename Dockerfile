# The package, built, with everything that ./run_demo and ./run_tests install. The page is on the host's own network:
#
#     docker build -t gspn .
#     docker run --rm -it --network host gspn
#
# For Noetic: --build-arg IMAGE=ros:noetic-ros-core-focal
ARG IMAGE=debian:12
FROM ${IMAGE}
WORKDIR /gspn_framework_package
COPY . .
RUN bash scripts/prepare.sh
CMD ["./run_demo", "--headless"]
