// An AXI4 slave in front of the memory port: INCR, FIXED and WRAP bursts, narrow and unaligned
// beats, byte strobes. One burst at a time, reads and writes in turn.
//
// The memories behind take whole words only. A beat that writes part of a word reads the word
// first, which costs some cycles; whole words stream at one a cycle. If that read is refused, so is
// the beat, but the status does not tell of a write. Exclusive accesses, cache, protection and
// quality-of-service hints are not looked at.
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
    // A read of the word that a beat changes a part of.
    output logic                       fetch_o,
    output logic  [WORD_ADDR_BITS-1:0] addr_o,
    output logic  [       DATA_WL-1:0] wdata_o,
    input  logic                       rvalid_i,
    input  logic  [       DATA_WL-1:0] rdata_i,
    input  resp_e                      resp_i
);

  // Answers under way and answers waiting for the master fit together.
  localparam int unsigned FIFO_DEPTH = 2 ** $clog2(2 * (PORT_LATENCY + 1));
  localparam int unsigned CREDIT_BITS = $clog2(FIFO_DEPTH + 1);

  typedef enum logic [2:0] {
    Idle,
    Read,
    Write,
    // A partial beat: waits for the word that it changes a part of.
    Fetch,
    // All beats are written: waits for the last answer.
    Drain,
    Respond
  } state_e;

  state_e state_d, state_q;
  logic [ID_BITS-1:0] id_q;
  logic [ADDR_BITS-1:0] addr_q, next_addr;
  logic [7:0] len_q, beats_q;
  logic [2:0] size_q;
  logic [1:0] burst_q;
  logic [CREDIT_BITS-1:0] credits_q;
  // Who comes first when both wait.
  logic write_turn_q;
  resp_e resp_d, resp_q;

  logic take_ar, take_aw, beat_done, all_asked_q;
  logic read_req, pop, full_beat, empty_beat;

  pearl_axi_address #(
      .ADDR_BITS(ADDR_BITS)
  ) u_address (
      .addr_i (addr_q),
      .len_i  (len_q),
      .size_i (size_q),
      .burst_i(burst_q),
      .next_o (next_addr)
  );

  assign take_aw = state_q == Idle && s_axi_awvalid && (write_turn_q || !s_axi_arvalid);
  assign take_ar = state_q == Idle && s_axi_arvalid && !take_aw;
  assign s_axi_awready = take_aw;
  assign s_axi_arready = take_ar;

  assign full_beat = &s_axi_wstrb;
  assign empty_beat = s_axi_wstrb == '0;
  assign read_req = state_q == Read && !all_asked_q && credits_q != '0;

  // A word that was fetched is merged and written in the cycle in which it arrives, as the last answer
  // that is due; if the fetch failed, so would the write.
  logic merge;
  assign merge = state_q == Fetch && rvalid_i && 32'(credits_q) == FIFO_DEPTH - 1;
  assign s_axi_wready = (state_q == Write && (full_beat || empty_beat)) || merge;
  assign beat_done = read_req || (s_axi_wvalid && s_axi_wready);

  always_comb begin
    req_o = 1'b0;
    we_o  = 1'b0;
    unique case (state_q)
      Read: req_o = read_req;
      Write: begin
        req_o = s_axi_wvalid && !empty_beat;
        we_o  = full_beat;
      end
      Fetch: begin
        req_o = merge && resp_i == RespOkay;
        we_o  = 1'b1;
      end
      default: ;
    endcase
  end

  assign fetch_o = state_q == Write && !full_beat;
  assign addr_o  = addr_q[ADDR_BITS-1-:WORD_ADDR_BITS];
  for (genvar i = 0; i < STRB_BITS; i++) begin : gen_merge
    assign wdata_o[i*8+:8] = s_axi_wstrb[i] ? s_axi_wdata[i*8+:8] : rdata_i[i*8+:8];
  end

  always_comb begin
    state_d = state_q;
    unique case (state_q)
      Idle: begin
        if (take_aw) state_d = Write;
        if (take_ar) state_d = Read;
      end
      Read: if (pop && s_axi_rlast) state_d = Idle;
      Write: begin
        if (s_axi_wvalid) begin
          if (!full_beat && !empty_beat) state_d = Fetch;
          else if (s_axi_wlast) state_d = Drain;
        end
      end
      Fetch: if (merge) state_d = s_axi_wlast ? Drain : Write;
      Drain: if (32'(credits_q) == FIFO_DEPTH) state_d = Respond;
      Respond: if (s_axi_bready) state_d = Idle;
      default: state_d = Idle;
    endcase
  end

  // The worst answer of a burst's beats is the burst's.
  always_comb begin
    resp_d = resp_q;
    if (state_q == Idle) resp_d = RespOkay;
    else if (rvalid_i && resp_i > resp_q) resp_d = resp_i;
  end

  always_ff @(posedge clk_i or negedge rst_ni) begin
    if (!rst_ni) begin
      state_q      <= Idle;
      write_turn_q <= 1'b0;
      credits_q    <= CREDIT_BITS'(FIFO_DEPTH);
    end else begin
      state_q <= state_d;
      if (take_ar) write_turn_q <= 1'b1;
      if (take_aw) write_turn_q <= 1'b0;
      // A read holds its credit until the master has taken the answer, a write until it is answered.
      credits_q <= credits_q - CREDIT_BITS'(req_o) + CREDIT_BITS'(state_q == Read ? pop : rvalid_i);
    end
  end

  always_ff @(posedge clk_i) begin
    resp_q <= resp_d;
    if (take_ar || take_aw) begin
      id_q        <= take_aw ? s_axi_awid : s_axi_arid;
      addr_q      <= take_aw ? s_axi_awaddr : s_axi_araddr;
      len_q       <= take_aw ? s_axi_awlen : s_axi_arlen;
      beats_q     <= take_aw ? s_axi_awlen : s_axi_arlen;
      size_q      <= take_aw ? s_axi_awsize : s_axi_arsize;
      burst_q     <= take_aw ? s_axi_awburst : s_axi_arburst;
      all_asked_q <= 1'b0;
    end else if (beat_done) begin
      addr_q      <= next_addr;
      beats_q     <= beats_q - 1'b1;
      all_asked_q <= beats_q == '0;
    end
  end

  assign s_axi_bid = id_q;
  assign s_axi_bresp = resp_q;
  assign s_axi_bvalid = state_q == Respond;

  logic [7:0] answered_q;
  logic [1:0] read_resp;
  always_ff @(posedge clk_i) begin
    if (take_ar) answered_q <= '0;
    else if (pop) answered_q <= answered_q + 1'b1;
  end

  pearl_fifo #(
      .WIDTH(DATA_WL + 2),
      .DEPTH(FIFO_DEPTH)
  ) u_answers (
      .clk_i,
      .rst_ni,
      .push_i (state_q == Read && rvalid_i),
      .data_i ({resp_i, rdata_i}),
      .valid_o(s_axi_rvalid),
      .data_o ({read_resp, s_axi_rdata}),
      .pop_i  (pop)
  );

  assign pop = s_axi_rvalid && s_axi_rready;
  assign s_axi_rid = id_q;
  assign s_axi_rresp = read_resp;
  assign s_axi_rlast = answered_q == len_q;

endmodule
