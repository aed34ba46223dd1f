// Program on Fast DDS with types and topics of ROS 2: the other side of a link.
//
// Arguments: the domain, and the first range of the scans to send. It prints the cells of the map on /map, which was
// sent before it joined, and sends scans until standard input ends.

#include <poll.h>
#include <unistd.h>

#include <chrono>
#include <cstdlib>
#include <iostream>
#include <memory>
#include <thread>

#include <fastdds/dds/domain/DomainParticipant.hpp>
#include <fastdds/dds/domain/DomainParticipantFactory.hpp>
#include <fastdds/dds/publisher/DataWriter.hpp>
#include <fastdds/dds/publisher/Publisher.hpp>
#include <fastdds/dds/subscriber/DataReader.hpp>
#include <fastdds/dds/subscriber/SampleInfo.hpp>
#include <fastdds/dds/subscriber/Subscriber.hpp>
#include <fastdds/dds/topic/TypeSupport.hpp>
#include <fastdds/rtps/transport/UDPv4TransportDescriptor.h>

#include "messagesPubSubTypes.h"

using namespace eprosima::fastdds::dds;
using Scan = sensor_msgs::msg::dds_::LaserScan_;
using Map = nav_msgs::msg::dds_::OccupancyGrid_;

namespace {

constexpr int kPeriod = 100;  // milliseconds between two scans

DomainParticipantQos on_loopback() {
  auto udp = std::make_shared<eprosima::fastdds::rtps::UDPv4TransportDescriptor>();
  udp->interfaceWhiteList.push_back("127.0.0.1");
  DomainParticipantQos qos = PARTICIPANT_QOS_DEFAULT;
  qos.transport().use_builtin_transports = false;
  qos.transport().user_transports.push_back(udp);
  eprosima::fastrtps::rtps::Locator_t peer;
  eprosima::fastrtps::rtps::IPLocator::setIPv4(peer, 127, 0, 0, 1);
  qos.wire_protocol().builtin.initialPeersList.push_back(peer);
  return qos;
}

bool input_ended() {
  pollfd input{STDIN_FILENO, POLLIN, 0};
  char byte;
  return poll(&input, 1, kPeriod) > 0 && read(STDIN_FILENO, &byte, 1) <= 0;
}

}  // namespace

int main(int, char** arguments) {
  auto* participant =
      DomainParticipantFactory::get_instance()->create_participant(std::atoi(arguments[1]), on_loopback());
  TypeSupport scan_type(new sensor_msgs::msg::dds_::LaserScan_PubSubType());
  TypeSupport map_type(new nav_msgs::msg::dds_::OccupancyGrid_PubSubType());
  scan_type.register_type(participant);
  map_type.register_type(participant);
  auto* scans = participant->create_topic("rt/scan", scan_type.get_type_name(), TOPIC_QOS_DEFAULT);
  auto* maps = participant->create_topic("rt/map", map_type.get_type_name(), TOPIC_QOS_DEFAULT);

  DataReaderQos latched = DATAREADER_QOS_DEFAULT;
  latched.reliability().kind = RELIABLE_RELIABILITY_QOS;
  latched.durability().kind = TRANSIENT_LOCAL_DURABILITY_QOS;
  auto* reader = participant->create_subscriber(SUBSCRIBER_QOS_DEFAULT)->create_datareader(maps, latched);
  DataWriterQos sensor_data = DATAWRITER_QOS_DEFAULT;
  sensor_data.reliability().kind = BEST_EFFORT_RELIABILITY_QOS;
  auto* writer = participant->create_publisher(PUBLISHER_QOS_DEFAULT)->create_datawriter(scans, sensor_data);

  Map map;
  SampleInfo info;
  while (reader->take_next_sample(&map, &info) != ReturnCode_t::RETCODE_OK || !info.valid_data) {
    if (input_ended()) return 1;
  }
  std::cout << "map [";
  for (size_t k = 0; k < map.data().size(); ++k) {
    std::cout << (k ? ", " : "") << static_cast<int>(static_cast<int8_t>(map.data()[k]));
  }
  std::cout << "]" << std::endl;

  Scan scan;
  scan.header().stamp().sec(7);
  scan.header().stamp().nanosec(8);
  scan.header().frame_id("laser");
  scan.angle_min(-1.0f);
  scan.angle_max(1.0f);
  scan.angle_increment(1.0f);
  scan.range_min(0.1f);
  scan.range_max(9.0f);
  scan.ranges({std::strtof(arguments[2], nullptr), 2.0f, 3.0f});
  while (!input_ended()) {
    writer->write(&scan);
  }
  participant->delete_contained_entities();
  DomainParticipantFactory::get_instance()->delete_participant(participant);
  return 0;
}
