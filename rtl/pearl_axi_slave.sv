// SPDX-License-Identifier: MIT
// An AXI4 slave in front of the memory port: INCR, FIXED and WRAP bursts, narrow and unaligned
// beats, byte strobes.
//
// Reads and writes go on at the same time. The port takes one request a cycle, from whichever half has one; if
// both have, they take turns. Neither half waits for the other half's master, be it for data or for an answer
// to be taken. Bursts of a kind follow each other without a gap, in the order of their addresses, and so do their
// answers, whatever their IDs: K queued bursts of N whole words take K * N + PORT_LATENCY + 4 cycles from the
// first address to the last answer, both included, and about twice as long with as many of the other kind.
// Between a read and a write, order is as AXI has it: what is asked for after the other's answer comes after it.
// No output depends on an input from the bus in the same cycle.
//
// A beat that writes part of a word reads the word first, and reads wait for those PORT_LATENCY + 1 cycles. The
// first of the two requests is marked as a fetch, so that the port can refuse it as it would the write.
// Exclusive accesses, cache, protection and quality-of-service hints are not looked at.
module pearl_axi_slave
  import pearl_pkg::*;
#(
    parameter int unsigned DATA_WL = 32,
    parameter int unsigned ADDR_BITS = 16,
    parameter int unsigned ID_BITS = 4,
    localparam int unsigned STRB_BITS = DATA_WL / 8,
    localparam int unsigned WORD_ADDR_BITS = ADDR_BITS - $clog2(STRB_BITS)
) (
    input logic clk_i,
    input logic rst_ni,

    // Named as the standard names them, without the suffixes of the other ports, because block
    // design tools and test libraries find an AXI interface by its names.
    input  logic [  ID_BITS-1:0] s_axi_awid,
    input  logic [ADDR_BITS-1:0] s_axi_awaddr,
    input  logic [          7:0] s_axi_awlen,
    input  logic [          2:0] s_axi_awsize,
    input  logic [          1:0] s_axi_awburst,
    input  logic                 s_axi_awvalid,
    output logic                 s_axi_awready,
    input  logic [  DATA_WL-1:0] s_axi_wdata,
    input  logic [STRB_BITS-1:0] s_axi_wstrb,
    input  logic                 s_axi_wlast,
    input  logic                 s_axi_wvalid,
    output logic                 s_axi_wready,
    output logic [  ID_BITS-1:0] s_axi_bid,
    output logic [          1:0] s_axi_bresp,
    output logic                 s_axi_bvalid,
    input  logic                 s_axi_bready,
    input  logic [  ID_BITS-1:0] s_axi_arid,
    input  logic [ADDR_BITS-1:0] s_axi_araddr,
    input  logic [          7:0] s_axi_arlen,
    input  logic [          2:0] s_axi_arsize,
    input  logic [          1:0] s_axi_arburst,
    input  logic                 s_axi_arvalid,
    output logic                 s_axi_arready,
    output logic [  ID_BITS-1:0] s_axi_rid,
    output logic [  DATA_WL-1:0] s_axi_rdata,
    output logic [          1:0] s_axi_rresp,
    output logic                 s_axi_rlast,
    output logic                 s_axi_rvalid,
    input  logic                 s_axi_rready,

    output logic                       req_o,
    output logic                       we_o,
    // The read is on behalf of a write of part of the word.
    output logic                       fetch_o,
    output logic  [WORD_ADDR_BITS-1:0] addr_o,
    output logic  [       DATA_WL-1:0] wdata_o,
    input  logic                       rvalid_i,
    input  logic  [       DATA_WL-1:0] rdata_i,
    input  resp_e                      resp_i
);

  logic read_wants, read_grant, write_wants, write_grant, write_holds, write_req, write_we;
  logic [WORD_ADDR_BITS-1:0] read_addr, write_addr;
  // Where in the port reads are that the reading half has asked for.
  logic [PORT_LATENCY-1:0] reads_q;
  logic of_read;
  assign of_read = reads_q[PORT_LATENCY-1];

  pearl_axi_read #(
      .DATA_WL  (DATA_WL),
      .ADDR_BITS(ADDR_BITS),
      .ID_BITS  (ID_BITS)
  ) u_read (
      .clk_i,
      .rst_ni,
      .ar_valid_i(s_axi_arvalid),
      .ar_ready_o(s_axi_arready),
      .ar_id_i   (s_axi_arid),
      .ar_addr_i (s_axi_araddr),
      .ar_len_i  (s_axi_arlen),
      .ar_size_i (s_axi_arsize),
      .ar_burst_i(s_axi_arburst),
      .r_valid_o (s_axi_rvalid),
      .r_ready_i (s_axi_rready),
      .r_id_o    (s_axi_rid),
      .r_data_o  (s_axi_rdata),
      .r_resp_o  (s_axi_rresp),
      .r_last_o  (s_axi_rlast),
      .wants_o   (read_wants),
      .grant_i   (read_grant),
      .addr_o    (read_addr),
      .answer_i  (of_read),
      .data_i    (rdata_i),
      .resp_i    (resp_i)
  );

  pearl_axi_write #(
      .DATA_WL  (DATA_WL),
      .ADDR_BITS(ADDR_BITS),
      .ID_BITS  (ID_BITS)
  ) u_write (
      .clk_i,
      .rst_ni,
      .aw_valid_i(s_axi_awvalid),
      .aw_ready_o(s_axi_awready),
      .aw_id_i   (s_axi_awid),
      .aw_addr_i (s_axi_awaddr),
      .aw_len_i  (s_axi_awlen),
      .aw_size_i (s_axi_awsize),
      .aw_burst_i(s_axi_awburst),
      .w_valid_i (s_axi_wvalid),
      .w_ready_o (s_axi_wready),
      .w_data_i  (s_axi_wdata),
      .w_strb_i  (s_axi_wstrb),
      .w_last_i  (s_axi_wlast),
      .b_valid_o (s_axi_bvalid),
      .b_ready_i (s_axi_bready),
      .b_id_o    (s_axi_bid),
      .b_resp_o  (s_axi_bresp),
      .wants_o   (write_wants),
      .grant_i   (write_grant),
      .holds_o   (write_holds),
      .req_o     (write_req),
      .we_o      (write_we),
      .fetch_o   (fetch_o),
      .addr_o    (write_addr),
      .wdata_o   (wdata_o),
      .answer_i  (rvalid_i && !of_read),
      .data_i    (rdata_i),
      .resp_i    (resp_i)
  );

  // ---- The port ----

  // The last turn was a read's.
  logic read_q;

  assign write_grant = write_wants && (!read_wants || read_q);
  assign read_grant = read_wants && !write_holds && !write_grant;

  assign req_o = read_grant || write_req;
  assign we_o = !read_grant && write_we;
  assign addr_o = read_grant ? read_addr : write_addr;

  always_ff @(posedge clk_i) begin
    if (!rst_ni) begin
      read_q  <= 1'b0;
      reads_q <= '0;
    end else begin
      if (read_grant || write_grant || write_holds) read_q <= read_grant;
      reads_q <= PORT_LATENCY'({reads_q, read_grant});
    end
  end

  logic [PORT_LATENCY-1:0] due_q;
  always_ff @(posedge clk_i) begin
    if (!rst_ni) due_q <= '0;
    else due_q <= PORT_LATENCY'({due_q, req_o});
    if (rst_ni) begin
      assert (due_q[PORT_LATENCY-1] || !rvalid_i)
      else $error("pearl_axi_slave: an answer came that nobody asked for");
      assert (rvalid_i || !due_q[PORT_LATENCY-1])
      else $error("pearl_axi_slave: an answer did not come after PORT_LATENCY cycles");
    end
  end

endmodule
